"""Tracks as DeepLabCut writes them (CSV, HDF5): parts of bodies of animals, in pixels."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vidphys.data.formats.animals import HDF5, arrays_of_tracks, holds
from vidphys.data.formats.base import Recording
from vidphys.data.formats.bounded import require_room
from vidphys.data.formats.poses import of_parts
from vidphys.data.formats.text import decoded
from vidphys.errors import InputError

BEGIN, END = "scorer", "coords"  # of the lines above the numbers
SURE = 0.6  # likelihood below which DeepLabCut itself leaves a place out
AXES = ("x", "y", "z")


def is_deeplabcut(path: Path) -> bool:
    """Whether a file begins as its texts do, or has its table in HDF5."""
    if path.suffix.lower() in HDF5:
        return holds(path, "heads")
    with path.open("rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf").startswith(BEGIN.encode() + b",")


def read_deeplabcut(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """Each part of each animal is a body; NaN where it was not seen, or not surely.

    Raises:
        InputError: labels of single pictures, a table that ends early, or a part that it does not
            have.
    """
    heads, index, values = _binary(path) if path.suffix.lower() in HDF5 else _text(path)
    names, which = _bodies(heads)
    frames = _frames(index)
    places = np.stack([_places(values, which[name]) for name in names], 1)
    found = of_parts(places, names, columns, frames, interval, "DeepLabCut's parts")
    return replace(found, notes=(f"{found.notes[0]}; unseen where likelihood is below {SURE}",))


def _binary(path: Path) -> tuple[dict[str, list[str]], np.ndarray, np.ndarray]:
    """Names of the columns by their level, what rows begin with, and their numbers."""
    held = arrays_of_tracks(path)
    heads = dict(zip(held["levels"].tolist(), held["heads"].tolist(), strict=True))
    _require_heads(heads, len(held["values"]))
    return heads, held["index"], held["values"]


def _text(path: Path) -> tuple[dict[str, list[str]], np.ndarray, np.ndarray]:
    """See :func:`_binary`."""
    heads, rows = _lines(path)
    require_room((len(rows), len(rows[0])), 8, "frames by columns")
    cells = np.array([[_number(cell) for cell in row] for row in rows])
    return heads, cells[:, 0], cells[:, 1:]


def _lines(path: Path) -> tuple[dict[str, list[str]], list[list[str]]]:
    """The lines above the numbers by their first cell, and the rows of numbers."""
    lines = [row for row in csv.reader(decoded(path).splitlines()) if any(row)]
    at = next((k for k, row in enumerate(lines) if row[0] == END), len(lines))
    heads = {row[0]: [cell.strip() for cell in row[1:]] for row in lines[: at + 1]}
    _require_heads(heads, len(lines) - at - 1)
    width = len(lines[at])
    return heads, [row for row in lines[at + 1 :] if len(row) == width]


def _require_heads(heads: Mapping[str, Sequence[str]], rows: int) -> None:
    if "bodyparts" not in heads or END not in heads or rows < 1:
        raise InputError("begins as DeepLabCut's table, but has no bodyparts, coords and rows")


def _bodies(heads: Mapping[str, Sequence[str]]) -> tuple[list[str], dict[str, dict[str, int]]]:
    """Names of the bodies, and of each the columns of its coordinates and likelihood."""
    parts, animals = heads["bodyparts"], heads.get("individuals", [""] * len(heads["bodyparts"]))
    several = len(set(animals)) > 1
    which: dict[str, dict[str, int]] = {}
    for k, (animal, part, what) in enumerate(zip(animals, parts, heads[END], strict=False)):
        which.setdefault(f"{animal} {part}" if several else part, {})[what] = k
    return list(which), which


def _frames(index: np.ndarray) -> np.ndarray:
    """Numbers of the frames.

    Raises:
        InputError: they are no numbers that rise.
    """
    if not len(index) or not np.isfinite(index).all() or (np.diff(index) <= 0).any():
        raise InputError(
            "the first column is no number of a frame that rises: labels of single pictures are "
            "no motion; give the table that DeepLabCut writes of a video"
        )
    return index.astype(int)


def _places(values: np.ndarray, at: Mapping[str, int]) -> np.ndarray:
    axes = [axis for axis in AXES if axis in at]
    if len(axes) < 2:
        raise InputError(f"coords of a part are {', '.join(at)}; places need x and y")
    places = values[:, [at[axis] for axis in axes]]
    if "likelihood" in at:
        places = np.where(values[:, at["likelihood"], None] >= SURE, places, np.nan)
    return places


def _number(cell: str) -> float:
    try:
        return float(cell) if cell.strip() else np.nan
    except ValueError:
        return np.nan
