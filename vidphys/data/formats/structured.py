"""Tracks in JSON: columns or rows of a table, COCO's boxes, TAP-Vid's points."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vidphys.data.formats.base import Recording
from vidphys.data.formats.bounded import MOST_COLUMNS, reading
from vidphys.data.formats.coco import boxes_of, is_coco
from vidphys.data.formats.rows import recording_of
from vidphys.data.formats.tapvid import is_points, points_of
from vidphys.errors import InputError

MOST_JSON = 2**25  # bytes; as objects it takes some twenty times as many


def read_structured(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """A JSON file: ``{"t": [...], "x": [...]}``, a list of ``{"t": 0, "x": 1}``, COCO, TAP-Vid."""
    held = parsed(path)
    if is_coco(held):
        return boxes_of(held, columns, interval)
    if is_points(held):
        return points_of(held["points"], held["occluded"], interval)
    return recording_of(_table(held), columns, interval, called=path.stem)


def structured_table(path: Path) -> dict[str, np.ndarray]:
    """The columns of a JSON file; none of COCO's boxes and TAP-Vid's points."""
    held = parsed(path)
    return {} if is_coco(held) or is_points(held) else _table(held)


def parsed(path: Path) -> Any:
    """What a JSON file holds.

    Raises:
        InputError: it is too large, or no JSON.
    """
    if path.stat().st_size > MOST_JSON:
        raise InputError(f"more than {MOST_JSON >> 20} MiB of JSON; give fewer rows, or a Parquet")
    with reading("JSON"):
        return json.loads(path.read_bytes(), parse_constant=_nothing)


def _nothing(_word: str) -> None:
    """NaN and infinities are no JSON, though many write them: nothing was seen."""
    return


def _table(held: Any) -> dict[str, np.ndarray]:
    """Columns of equal length, numbers or words."""
    if isinstance(held, list) and held and all(isinstance(row, dict) for row in held):
        names = list(dict.fromkeys(name for row in held[:MOST_COLUMNS] for name in row))
        held = {name: [row.get(name) for row in held] for name in names[:MOST_COLUMNS]}
    if not isinstance(held, dict):
        raise InputError("no table: wants {name: [numbers, ...]}, or a list of {name: number}")
    lists = {name: cells for name, cells in held.items() if isinstance(cells, list)}
    counts = {len(cells) for cells in lists.values()}
    if len(counts) != 1 or len(lists) > MOST_COLUMNS:
        lengths = ", ".join(f"{name} {len(cells)}" for name, cells in list(lists.items())[:20])
        raise InputError(f"no columns of one length; has {lengths or 'no lists'}")
    return {name: _column(name, cells) for name, cells in lists.items()}


def _column(name: str, cells: list[Any]) -> np.ndarray:
    if all(cell is None or isinstance(cell, int | float) for cell in cells):
        with reading(f"numbers in column {name}"):
            return np.array([np.nan if cell is None else float(cell) for cell in cells])
    if all(cell is None or isinstance(cell, str) for cell in cells):
        return np.array(["" if cell is None else cell[:300] for cell in cells])
    raise InputError(f"column {name}: holds neither numbers nor words")
