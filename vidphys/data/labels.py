"""Positions of a clip's bodies, from a table of any known format that lies beside it.

``NAME.csv`` beside ``NAME.mp4``: columns ``x1, y1, x2, y2, ...`` (one pair for each body) in units
of which half the longer image side has ``half_extent``, from the image's centre, y upwards; or
``u1, v1, ...`` in pixels from the top left corner, v downwards. A row is a frame of the file, or
says which by a column ``frame``, counted from 0. A column ``time`` (seconds) is compared with the
clip's stamps; an empty cell says that a body was not seen; other columns are left out. ``NAME.npz``
holds the same as ``positions`` or ``pixels`` ``(t, n, 2)``, and ``times (t,)``.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vidphys.data.formats import Recording, read_recording
from vidphys.errors import InputError

if TYPE_CHECKING:
    from binders import Tracks
    from vidphys.data.video import ClipSelection, Video

HALF = 0.5  # of a frame interval: a label's time may be off by so much


@dataclass(frozen=True)
class Labels:
    """Where labels come from.

    Args:
        name: of the file or column that they are in, to be told.
        read: gives them; its argument says what columns are, see
            :class:`vidphys.data.formats.TrackFormat`.
        path: of their file, where it is theirs alone.
        names: of the columns that places are found among; ``None`` where there surely are some.
    """

    name: str
    read: Callable[[Mapping[str, str]], Recording]
    path: Path | None = None
    names: tuple[str, ...] | None = None

    @classmethod
    def of(cls, path: Path) -> Labels:
        """Those of a file."""
        read = partial(read_recording, path, in_picture=True)
        return cls(path.name, read, path)


def read_labels(
    labels: Labels | Path,
    video: Video,
    selection: ClipSelection,
    half_extent: float,
    columns: Mapping[str, str] | None = None,
) -> Tracks:
    """The labels of the frames that were read, in normalised image units, one episode.

    Args:
        labels: the table.
        video: the clip that it belongs to.
        selection: which frames of the file ``video`` has; the table has all of them.
        half_extent: units of ``x`` and ``y`` in half of the longer image side.
        columns: what columns of the table are, where their names do not tell.

    Raises:
        InputError: not such a table, one of another length or of other times than the clip.
    """
    import torch

    from binders import Tracks

    labels = Labels.of(labels) if isinstance(labels, Path) else labels
    where = labels.path or f"{video.path}: {labels.name}"
    try:
        table = labels.read(columns or {})
    except InputError as error:
        raise InputError(f"{where}: {error}" if labels.path is None else str(error)) from error
    if len(table.positions) != 1 or table.positions.shape[-1] != 2 or table.unit == "angles":
        raise InputError(
            f"{where}: labels are places in the plane of one clip; a table of them has columns "
            "x1,y1,x2,y2,... (units, y upwards) or u1,v1,... (pixels), and time if you have it"
        )
    table = _by_frame(where, table, video, selection)
    _check_times(where, table, video)
    points = table.positions[0, video.indices]
    if table.unit in ("pixels", "picture"):
        height, width = video.size
        from_edge = points * [width, height] if table.unit == "picture" else points + 0.5
        centred = (from_edge - np.array([width, height]) / 2) * [1, -1]
        points = centred / (max(height, width) / 2)
    else:
        points = points / half_extent
    seen = np.isfinite(points).all(-1)
    if not seen.any(0).all():
        raise InputError(f"{where}: body {int((~seen.any(0)).argmax()) + 1} is seen in no frame")
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


def _by_frame(where: object, table: Recording, video: Video, selection: ClipSelection) -> Recording:
    """The table with a row for each frame of the file."""
    rows, last = table.positions.shape[1], int(video.indices[-1])
    most = last + selection.stride if selection.stop is None else np.inf
    number = None if table.frames is None else np.rint(table.frames).astype(int)
    whole = number is None or bool((np.diff(number) == 1).all())  # from 0, or from 1
    if whole and last < rows <= most:
        return table
    if number is None:
        raise InputError(
            f"{where}: {rows} rows, but {video.path.name} has frames up to number {last}; a "
            "table of labels has one row for each frame of the file, or a column frame"
        )
    if not 0 <= number.min() <= number.max() < max(most, last + 1):
        raise InputError(
            f"{where}: is of frames {number.min()} to {number.max()}, but {video.path.name} has "
            f"frames 0 to {last}"
        )
    positions = np.full((1, last + 1, *table.positions.shape[2:]), np.nan)
    inside = number <= last
    positions[0, number[inside]] = table.positions[0, inside]
    return replace(table, positions=positions, times=None, frames=None)


def _check_times(where: object, table: Recording, video: Video) -> None:
    if table.times is None or len(video.times) < 2:
        return
    said = table.times[0, video.indices]
    off = np.abs((said - said[0]) - (video.times - video.times[0])).max()
    if not off <= HALF * video.interval:
        raise InputError(
            f"{where}: its times differ from those of {video.path.name} by up to {off:.3g} s; "
            "correct them, or give the clip's frames per second as `rate`"
        )


def _interpolated(points: np.ndarray, seen: np.ndarray, times: np.ndarray) -> np.ndarray:
    filled = points.copy()
    for n in range(points.shape[1]):
        for axis in range(2):
            known = seen[:, n]
            filled[:, n, axis] = np.interp(times, times[known], points[known, n, axis])
    return filled
