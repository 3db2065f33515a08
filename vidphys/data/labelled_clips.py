"""The clips of a data set, decoded one after the other, with where their bodies are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from binders.base import Binder, MotionTracks, bind
from binders.tracks import Tracks
from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.labels import read_labels
from vidphys.data.video import ClipSelection, Video, open_video, require_frames
from vidphys.errors import InputError

SAME_RATE = 0.02


@dataclass(frozen=True)
class LabelledClip:
    """A decoded clip and where its bodies are.

    Args:
        file: on disk.
        video: its frames.
        tracks: normalised image units, one episode.
        camera: displacement of the background ``(t, 2)``, normalised image units.
        follows_camera: whether it was looked for; else it is zero.
    """

    file: ClipFile
    video: Video
    tracks: Tracks
    camera: Tensor
    follows_camera: bool


def read_clips(
    dataset: Dataset, selection: ClipSelection, binder: Binder
) -> Iterator[LabelledClip]:
    """The clips one after the other, so that only one is in memory at a time.

    Args:
        dataset: from :func:`find_dataset`.
        selection: the frames of each clip.
        binder: follows the bodies where there are no tables.

    Raises:
        InputError: a clip that cannot be read or is too short, one of another size, frame rate or
            number of bodies than the first, labels that do not fit, or nothing that moves.
    """
    first: LabelledClip | None = None
    for file in dataset.files:
        video = open_video(file.path, selection)
        require_frames(video)
        clip = _labelled(file, video, dataset, selection, binder)
        if first is not None:
            _check_alike(first, clip)
        first = first or clip
        yield clip


def _labelled(
    file: ClipFile,
    video: Video,
    dataset: Dataset,
    selection: ClipSelection,
    binder: Binder,
) -> LabelledClip:
    still = torch.zeros(len(video.times), 2)
    if file.labels is not None:
        told = dataset.half_extent, dataset.columns
        tracks = read_labels(file.labels, video, selection, *told)
        return LabelledClip(file, video, tracks, still, False)
    try:
        found = bind(binder, video.frames, video.times)
    except ValueError as error:
        raise InputError(f"{video.path}: {error}") from error
    if isinstance(found, MotionTracks):
        return LabelledClip(file, video, found.tracks, found.camera, True)
    return LabelledClip(file, video, found, still, False)


def _check_alike(first: LabelledClip, clip: LabelledClip) -> None:
    for what, a, b in (
        ("frame size", first.video.size, clip.video.size),
        ("number of bodies", *(c.tracks.positions.shape[2] for c in (first, clip))),
    ):
        if a != b:
            raise InputError(
                f"{clip.file.path}: {what} {b}, but {first.file.path.name} has {a}; the clips of a "
                "data set are alike"
            )
    a, b = first.video.interval, clip.video.interval
    if abs(b / a - 1) > SAME_RATE:
        raise InputError(
            f"{clip.file.path}: {1 / b:.4g} frames per second, but {first.file.path.name} has "
            f"{1 / a:.4g}; convert it, or give the rate of all as `rate`"
        )
