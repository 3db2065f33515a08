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
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vidphys.data.formats import Recording, read_recording, read_table
from vidphys.data.formats.rows import columns_of
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
        table: gives all columns by name, numbers or words, ``(rows,)`` each; none where there are
            but places.
    """

    name: str
    read: Callable[[Mapping[str, str]], Recording]
    path: Path | None = None
    names: tuple[str, ...] | None = None
    table: Callable[[], Mapping[str, np.ndarray]] = dict

    @classmethod
    def of(cls, path: Path) -> Labels:
        """Those of a file."""
        read = partial(read_recording, path, in_picture=True)
        return cls(path.name, read, path, table=partial(read_table, path))


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
    points = read_places(labels, video, selection, half_extent, columns)
    seen = np.isfinite(points).all(-1)
    if not seen.any(0).all():
        body = int((~seen.any(0)).argmax()) + 1
        raise InputError(f"{_where(labels, video)}: body {body} is seen in no frame")
    filled = _interpolated(points, seen, video.times)
    positions, sure = (torch.from_numpy(x).float()[None] for x in (filled, seen.astype(float)))
    return Tracks(positions, sure, torch.from_numpy(video.times))


def read_places(
    labels: Labels,
    video: Video,
    selection: ClipSelection,
    half_extent: float,
    columns: Mapping[str, str] | None = None,
) -> np.ndarray:
    """The same as float64 ``(t, n, 2)``, NaN where a body was not seen.

    Args:
        labels, video, selection, half_extent, columns: see :func:`read_labels`.

    Raises:
        InputError: see there.
    """
    where = _where(labels, video)
    try:
        table = labels.read(columns or {})
    except InputError as error:
        raise InputError(f"{where}: {error}" if labels.path is None else str(error)) from error
    if len(table.positions) != 1 or table.positions.shape[-1] != 2 or table.unit == "angles":
        raise InputError(
            f"{where}: labels are places in the plane of one clip; a table of them has columns "
            "x1,y1,x2,y2,... (units, y upwards) or u1,v1,... (pixels), and time if you have it"
        )
    rows = _rows(where, table.positions.shape[1], table.frames, video, selection)
    if table.times is not None:
        _check_times(where, table.times[0, rows], video)
    points = np.where((rows >= 0)[:, None, None], table.positions[0, rows], np.nan)
    if table.unit in ("pixels", "picture"):
        height, width = video.size
        from_edge = points * [width, height] if table.unit == "picture" else points + 0.5
        centred = (from_edge - np.array([width, height]) / 2) * [1, -1]
        return centred / (max(height, width) / 2)
    return points / half_extent


def read_columns(
    labels: Labels,
    video: Video,
    selection: ClipSelection,
    columns: Mapping[str, str] | None = None,
) -> dict[str, np.ndarray]:
    """All columns of the labels for the frames that were read, ``(t,)`` each, by their own names.

    Numbers are NaN, and words ``None``, in a frame that has no row; where each body has rows of its
    own, see :func:`vidphys.data.formats.rows.columns_of`.

    Args:
        labels, video, selection, columns: see :func:`read_labels`.

    Raises:
        InputError: a table that cannot be read, of several clips, or of another length.
    """
    where, table = _where(labels, video), labels.table()
    if not table:
        return {}
    try:
        held, frames = columns_of(table, columns or {})
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    rows = _rows(where, len(next(iter(held.values()))), frames, video, selection)
    if (rows >= 0).all():
        return {name: values[rows] for name, values in held.items()}
    return {name: _with_gaps(values, rows) for name, values in held.items()}


def _with_gaps(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    numbers = values.dtype.kind in "fiub"
    found = values.astype(float if numbers else object)[rows]
    found[rows < 0] = np.nan if numbers else None
    return found


def _where(labels: Labels, video: Video) -> str:
    return str(labels.path or f"{video.path}: {labels.name}")


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


def _rows(
    where: str, count: int, frames: np.ndarray | None, video: Video, selection: ClipSelection
) -> np.ndarray:
    """The row of each frame that was read, ``(t,)``; -1 where it has none.

    Args:
        where: the table, for errors.
        count: of its rows.
        frames: number of the frame that each row is of, ``(count,)``, where the table says it.
        video, selection: see :func:`read_labels`.
    """
    last = int(video.indices[-1])
    most = last + selection.stride if selection.stop is None else np.inf
    number = None if frames is None else np.rint(frames).astype(int)
    whole = number is None or bool((np.diff(number) == 1).all())  # from 0, or from 1
    if whole and last < count <= most:
        return video.indices
    if number is None:
        raise InputError(
            f"{where}: {count} rows, but {video.path.name} has frames up to number {last}; a "
            "table of labels has one row for each frame of the file, or a column frame"
        )
    if not 0 <= number.min() <= number.max() < max(most, last + 1):
        raise InputError(
            f"{where}: is of frames {number.min()} to {number.max()}, but {video.path.name} has "
            f"frames 0 to {last}"
        )
    rows = np.full(last + 1, -1)
    inside = number <= last
    rows[number[inside]] = np.flatnonzero(inside)
    return rows[video.indices]


def _check_times(where: str, said: np.ndarray, video: Video) -> None:
    """Hold the times that a table has of the frames to their own."""
    if len(video.times) < 2:
        return
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
