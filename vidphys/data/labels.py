"""Positions that lie beside a clip, in a table of one row for each frame, of any known format.

``NAME.csv`` beside ``NAME.mp4``: columns ``x1, y1, x2, y2, ...`` (one pair for each body) in units
of which half the longer image side has ``half_extent``, from the image's centre, y upwards; or
``u1, v1, ...`` in pixels from the top left corner, v downwards. A column ``time`` (seconds) is
compared with the clip's stamps; an empty cell says that a body was not seen. ``NAME.npz`` holds
the same as ``positions`` or ``pixels`` ``(t, n, 2)``, and ``times (t,)``.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import torch

from binders.tracks import Tracks
from vidphys.data.formats import Recording, TrackFormat, format_of, read_recording, suffixes_of
from vidphys.data.video import ClipSelection, Video
from vidphys.errors import InputError

HALF = 0.5  # of a frame interval: a label's time may be off by so much


def labels_beside(clip: Path) -> Path | None:
    """The file of labels of a clip, if there is one.

    Raises:
        InputError: there are two.
    """
    beside = (path for path in map(clip.with_suffix, suffixes_of(TrackFormat)) if path.is_file())
    formats = ((path, format_of(path, TrackFormat)) for path in beside)
    found = [path for path, format in formats if format is not None and format.beside_clips]
    if len(found) > 1:
        raise InputError(f"{clip}: has two files of labels, {found[0].name} and {found[1].name}")
    return found[0] if found else None


def read_labels(path: Path, video: Video, selection: ClipSelection, half_extent: float) -> Tracks:
    """The labels of the frames that were read, in normalised image units, one episode.

    Args:
        path: the table.
        video: the clip that it belongs to.
        selection: which frames of the file ``video`` has; the table has all of them.
        half_extent: units of ``x`` and ``y`` in half of the longer image side.

    Raises:
        InputError: not such a table, one of another length or of other times than the clip.
    """
    table = read_recording(path)
    if len(table.positions) != 1 or table.positions.shape[-1] != 2 or table.unit == "angles":
        raise InputError(
            f"{path}: labels are places in the plane of one clip; a table of them has columns "
            "x1,y1,x2,y2,... (units, y upwards) or u1,v1,... (pixels), and time if you have it"
        )
    _check_length(path, table, video, selection)
    _check_times(path, table, video)
    points = table.positions[0, video.indices]
    if table.unit == "pixels":
        height, width = video.size
        centred = (points + 0.5 - np.array([width, height]) / 2) * [1, -1]
        points = centred / (max(height, width) / 2)
    else:
        points = points / half_extent
    seen = np.isfinite(points).all(-1)
    if not seen.any(0).all():
        raise InputError(f"{path}: body {int((~seen.any(0)).argmax()) + 1} is seen in no frame")
    filled = _interpolated(points, seen, video.times)
    positions, sure = (torch.from_numpy(x).float()[None] for x in (filled, seen.astype(float)))
    return Tracks(positions, sure, torch.from_numpy(video.times))


def write_labels(path: Path, times: np.ndarray, positions: np.ndarray) -> None:
    """Write a table of ``positions (t, n, 2)`` at ``times`` (seconds), as :func:`read_labels` wants
    it, to nine digits.
    """
    bodies = range(1, positions.shape[1] + 1)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time", *(f"{axis}{n}" for n in bodies for axis in "xy")])
        for time, places in zip(times, positions.reshape(len(times), -1), strict=True):
            writer.writerow([f"{value:.9g}" for value in (time, *places)])


def _check_length(path: Path, table: Recording, video: Video, selection: ClipSelection) -> None:
    rows, last = table.positions.shape[1], int(video.indices[-1])
    most = last + selection.stride if selection.stop is None else rows
    if not last < rows <= most:
        raise InputError(
            f"{path}: {rows} rows, but {video.path.name} has frames up to number {last}; a "
            "table of labels has one row for each frame of the file"
        )


def _check_times(path: Path, table: Recording, video: Video) -> None:
    if table.times is None or len(video.times) < 2:
        return
    said = table.times[0, video.indices]
    off = np.abs((said - said[0]) - (video.times - video.times[0])).max()
    if not off <= HALF * video.interval:
        raise InputError(
            f"{path}: its times differ from those of {video.path.name} by up to {off:.3g} s; "
            "correct them, or give the clip's frames per second as `rate`"
        )


def _interpolated(points: np.ndarray, seen: np.ndarray, times: np.ndarray) -> np.ndarray:
    filled = points.copy()
    for n in range(points.shape[1]):
        for axis in range(2):
            known = seen[:, n]
            filled[:, n, axis] = np.interp(times, times[known], points[known, n, axis])
    return filled
