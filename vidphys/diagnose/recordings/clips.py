"""Tracks of a clip, by a binder that follows its bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from binders.base import Binder, MotionTracks
from binders.motion import MotionBinder
from vidphys.data.video import ClipSelection, Video, read_video, require_frames
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion
from vidphys.errors import InputError

SELDOM = 0.5  # share of the frames in which a body is not seen, from which it is said
MANY = 0.1  # share of the frames in which something else moves, from which it is said


def follow_clip(
    path: Path, selection: ClipSelection, binder: Binder
) -> tuple[Motion, Video, tuple[str, ...]]:
    """The motion of a clip's bodies before a still background, in normalised image units.

    Args:
        path: the video.
        selection: which of its frames are used.
        binder: follows the bodies.

    Returns:
        The motion, the pictures, and what a person should know of how it was followed.

    Raises:
        InputError: a clip that cannot be read or is too short, or in which nothing moves.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a table of tracks or a clip")
    video = read_video(path, selection)
    require_frames(video, LEAST_FRAMES)
    try:
        bound = binder(video.frames, video.times)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    if not isinstance(bound, MotionTracks):
        bound = MotionTracks(bound, torch.zeros(len(video.times), 2))
    positions = (bound.tracks.positions - bound.camera[None, :, None]).double().numpy()
    unseen = bound.tracks.confidence.numpy() <= 0
    motion = Motion(
        np.where(unseen[..., None], np.nan, positions),
        np.asarray(video.times, float)[None],
        np.ones((1, positions.shape[2])),
    )
    notes = [*video.notes, f"{len(video.frames)} frames of {video.interval:.4g} s followed"]
    if bound.others > MANY:
        notes.append(
            f"in {bound.others:.0%} of them something else moves as strongly; if it is a body of "
            f"the scene, follow more bodies than {positions.shape[2]}, else leave its frames out"
        )
    lit = isinstance(binder, MotionBinder) and (binder.shadow or 1) < 1
    if lit and unseen.mean((0, 1)).max() > SELDOM:
        notes.append(
            "a body is often not seen; if it differs from what is behind it in brightness alone, "
            "like a grey one, follow it with a shadow of 1"
        )
    return motion, video, tuple(notes)
