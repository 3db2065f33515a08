"""Positions that lie beside a clip, in a table of one row for each frame.

``NAME.csv`` beside ``NAME.mp4``: columns ``x1, y1, x2, y2, ...`` (one pair for each body) in units
of which half the longer image side has ``half_extent``, from the image's centre, y upwards; or
``u1, v1, ...`` in pixels from the top left corner, v downwards. A column ``time`` (seconds) is
compared with the clip's stamps; an empty cell says that a body was not seen. ``NAME.npz`` holds
the same as ``positions`` or ``pixels`` ``(t, n, 2)``, and ``times (t,)``.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from binders.tracks import Tracks
from vidphys.data.video import ClipSelection, Video
from vidphys.errors import InputError

SUFFIXES = (".csv", ".npz")
AXES = {"positions": ("x", "y"), "pixels": ("u", "v")}
HALF = 0.5  # of a frame interval: a label's time may be off by so much


@dataclass(frozen=True)
class Table:
    """What a file of labels says.

    Args:
        path: the file.
        points: ``(t, n, 2)``, NaN where a body was not seen.
        in_pixels: the unit; see the module.
        times: seconds ``(t,)``, or ``None``.
    """

    path: Path
    points: np.ndarray
    in_pixels: bool
    times: np.ndarray | None


def labels_beside(clip: Path) -> Path | None:
    """The file of labels of a clip, if there is one.

    Raises:
        InputError: there are two.
    """
    found = [path for path in map(clip.with_suffix, SUFFIXES) if path.is_file()]
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
    table = _read_npz(path) if path.suffix == ".npz" else _read_csv(path)
    _check_length(table, video, selection)
    _check_times(table, video)
    points = table.points[video.indices]
    if table.in_pixels:
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


def _read_csv(path: Path) -> Table:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = list(csv.reader(file))
    names = [name.strip() for name in rows[0]] if rows else []
    for kind, axes in AXES.items():
        bodies = sum(name.startswith(axes[0]) for name in names)
        wanted = [f"{axis}{n + 1}" for n in range(bodies) for axis in axes]
        if bodies and set(names) - {"time"} == set(wanted):
            try:
                cells = [[float(cell) if cell.strip() else np.nan for cell in r] for r in rows[1:]]
                values = np.array(cells, np.float64).reshape(len(cells), len(names))
            except ValueError as error:
                raise InputError(f"{path}: a row is not {len(names)} numbers ({error})") from error
            points = values[:, [names.index(name) for name in wanted]].reshape(-1, bodies, 2)
            times = values[:, names.index("time")] if "time" in names else None
            return Table(path, points, kind == "pixels", times)
    raise InputError(
        f"{path}: its first line is {','.join(names) or 'empty'}; a table of labels has columns "
        "x1,y1,x2,y2,... (units, y upwards) or u1,v1,... (pixels), and time if you have it"
    )


def _read_npz(path: Path) -> Table:
    try:
        with np.load(path) as file:
            arrays = {name: np.asarray(file[name], np.float64) for name in file.files}
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not an npz file of numbers ({error})") from error
    (kind, *more) = [name for name in AXES if name in arrays] or [""]
    if not kind or more or arrays[kind].ndim != 3 or arrays[kind].shape[2] != 2:
        shapes = ", ".join(f"{name} {x.shape}" for name, x in arrays.items())
        raise InputError(
            f"{path}: has {shapes or 'nothing'}; needs either positions or pixels, (t, n, 2)"
        )
    return Table(path, arrays[kind], kind == "pixels", arrays.get("times"))


def _check_length(table: Table, video: Video, selection: ClipSelection) -> None:
    rows, last = len(table.points), int(video.indices[-1])
    most = last + selection.stride if selection.stop is None else rows
    if not last < rows <= most:
        raise InputError(
            f"{table.path}: {rows} rows, but {video.path.name} has frames up to number {last}; a "
            "table of labels has one row for each frame of the file"
        )


def _check_times(table: Table, video: Video) -> None:
    if table.times is None or len(video.times) < 2:
        return
    said = table.times[video.indices]
    off = np.abs((said - said[0]) - (video.times - video.times[0])).max()
    if not off <= HALF * video.interval:
        raise InputError(
            f"{table.path}: its times differ from those of {video.path.name} by up to {off:.3g} s; "
            "correct them, or give the clip's frames per second with --rate"
        )


def _interpolated(points: np.ndarray, seen: np.ndarray, times: np.ndarray) -> np.ndarray:
    filled = points.copy()
    for n in range(points.shape[1]):
        for axis in range(2):
            known = seen[:, n]
            filled[:, n, axis] = np.interp(times, times[known], points[known, n, axis])
    return filled
