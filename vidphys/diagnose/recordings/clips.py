"""Tracks of a clip, by a binder that follows its bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from binders.base import Binder, MotionTracks, bind
from binders.motion import MotionBinder
from vidphys.data.cuts import liveliest, parts
from vidphys.data.sets import is_in_set
from vidphys.data.video import ClipSelection, Video, open_video, require_frames
from vidphys.diagnose.recordings.broken import Mended, mend
from vidphys.diagnose.recordings.leaps import without_leaps
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion
from vidphys.diagnose.recordings.used import Used, counted
from vidphys.errors import InputError

SELDOM = 0.5  # share of the frames in which a body is not seen, from which it is said
MANY = 0.1  # share of the frames in which something else moves, from which it is said


@dataclass(frozen=True)
class Followed:
    """The motion of a clip's bodies.

    Args:
        motion: before a still background, in normalised image units; a row for each frame of the
            video, NaN in those that are left out.
        video: the pictures.
        used: which of its frames are looked at.
        notes: what a person should know of how it was followed.
    """

    motion: Motion
    video: Video
    used: Used
    notes: tuple[str, ...]


def follow_clip(path: Path, selection: ClipSelection, binder: Binder) -> Followed:
    """Follow the bodies of a clip, where it is cut in the part in which most moves.

    Args:
        path: the video.
        selection: which of its frames are read.
        binder: follows the bodies.

    Raises:
        InputError: a clip that cannot be read or is too short, or in which nothing moves.
    """
    video = clip_of(path, selection)
    first, stop, cut = whole_part(video, binder)
    try:
        told = _told(binder, selection.start + first)
        bound = bind(told, video.frames[first:stop], video.times[first:stop])
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    if not isinstance(bound, MotionTracks):
        bound = MotionTracks(bound, torch.zeros(stop - first, 2))
    positions = (bound.tracks.positions - bound.camera[None, :, None]).double().numpy()[0]
    unseen = bound.tracks.confidence.numpy()[0] <= 0
    mended = mend(
        np.where(unseen[..., None], np.nan, positions),
        video.times[first:stop],
        video.frames[first:stop],
    )
    mended = replace(mended, positions=without_leaps(mended.positions, mended.times))
    motion = _placed(mended, video.times, first, stop)
    used = _used(mended, selection, len(video.frames), (first, stop), cut)
    return Followed(motion, video, used, (*video.notes, *_notes(bound, unseen, binder)))


def clip_of(path: Path, selection: ClipSelection) -> Video:
    """A clip that is long enough to be followed.

    Raises:
        InputError: it cannot be read or is too short.
    """
    if not path.is_file() and not is_in_set(path):
        raise InputError(f"{path}: no such file; give a table of tracks or a clip")
    video = open_video(path, selection)
    require_frames(video, LEAST_FRAMES)
    return video


def whole_part(video: Video, binder: Binder) -> tuple[int, int, str]:
    """First frame of the part between cuts that is followed, the one after its last, and why.

    It is the part in which a body was said to be, or else in which something moves for longest.
    """
    found = parts(video.frames)
    said = binder.wanted.at if isinstance(binder, MotionBinder) else ()
    at = {int(np.searchsorted(video.indices, frame)) for _, _, frame in said}
    meant = [k for k, (first, stop) in enumerate(found) if at & set(range(first, stop))]
    chosen = meant[0] if meant else liveliest(video.frames, found) if len(found) > 1 else 0
    first, stop = found[chosen]
    if len(found) == 1 or stop - first < LEAST_FRAMES:
        return 0, len(video.frames), ""
    cuts = [str(video.indices[begin]) for begin, _ in found[1:]]
    where = f"cut{'s' if len(cuts) > 1 else ''} before frame {' and '.join(cuts)}"
    return first, stop, where


def _told(binder: Binder, first: int) -> Binder:
    """The binder, told of frames counted from the first that it gets."""
    if first == 0 or not (isinstance(binder, MotionBinder) and binder.wanted.at):
        return binder
    at = tuple((x, y, frame - first) for x, y, frame in binder.wanted.at)
    return replace(binder, wanted=replace(binder.wanted, at=at))


def _placed(mended: Mended, times: np.ndarray, first: int, stop: int) -> Motion:
    """The motion of a part as one of the whole video, in whose other frames nothing is seen."""
    positions = np.full((len(times), *mended.positions.shape[1:]), np.nan)
    positions[first:stop] = mended.positions
    late = mended.times[-1] - times[stop - 1]
    when = np.concatenate([times[:first], mended.times, times[stop:] + late])
    return Motion(positions[None], when[None], np.ones((1, positions.shape[1])))


def _used(
    mended: Mended, selection: ClipSelection, count: int, part: tuple[int, int], cut: str
) -> Used:
    begin, first = selection.start, part[0]
    why = [cut] if cut else []
    doubled, paused = ([begin + first + k for k in x] for x in (mended.doubled, mended.paused))
    if doubled:
        why.append(counted(doubled, "doubled"))
    if paused:
        why.append(f"{len(paused)} frames of a pause left out (from {paused[0]} on)")
    if mended.missing:
        lost = ", ".join(str(begin + first + k) for k, _ in mended.missing)
        why.append(f"frames are missing before {lost}, later times are moved by as many")
    total = begin + count if selection.stop is None else None
    return Used(total, begin, part, tuple(why), tuple(sorted(doubled + paused)))


def _notes(bound: MotionTracks, unseen: np.ndarray, binder: Binder) -> list[str]:
    notes = []
    if bound.others > MANY:
        bodies = unseen.shape[1]
        notes.append(
            f"in {bound.others:.0%} of the frames something else moves as strongly; if it is a "
            f"body of the scene, follow more bodies than {bodies}, else leave its frames out"
        )
    lit = isinstance(binder, MotionBinder) and (binder.shadow or 1) < 1
    if lit and unseen.mean(0).max() > SELDOM:
        notes.append(
            "a body is often not seen; if it differs from what is behind it in brightness alone, "
            "like a grey one, follow it with a shadow of 1"
        )
    return notes
