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
    """A JSON file: ``{"t": [...], "x": [...]}``, a list of ``{"t": 0, "x": 1}``, COCO, TAP-Vid.

    Also a row in each line, and a table as pandas writes it by default or split.
    """
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
    data = path.read_bytes()
    with reading("JSON"):
        try:
            return json.loads(data, parse_constant=_nothing)
        except json.JSONDecodeError as error:
            if error.msg != "Extra data":
                raise
        return [
            json.loads(row, parse_constant=_nothing) for row in data.splitlines() if row.strip()
        ]


def _nothing(_word: str) -> None:
    """NaN and infinities are no JSON, though many write them: nothing was seen."""
    return


def _table(held: Any) -> dict[str, np.ndarray]:
    """Columns of equal length, numbers or words."""
    held = _unpacked(held)
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


def _unpacked(held: Any) -> Any:
    """What pandas wrote with the names or numbers of its rows, without these."""
    if not isinstance(held, dict):
        return held
    if set(held) == {"columns", "index", "data"}:
        rows = [dict(zip(held["columns"], row, strict=False)) for row in held["data"]]
        return rows if all(isinstance(name, str) for name in held["columns"]) else held
    if held and all(isinstance(cells, dict) for cells in held.values()):
        return {name: list(cells.values()) for name, cells in held.items()}
    return held


def _column(name: str, cells: list[Any]) -> np.ndarray:
    if all(cell is None or isinstance(cell, int | float) for cell in cells):
        with reading(f"numbers in column {name}"):
            return np.array([np.nan if cell is None else float(cell) for cell in cells])
    if all(cell is None or isinstance(cell, str) for cell in cells):
        return np.array(["" if cell is None else cell[:300] for cell in cells])
    raise InputError(f"column {name}: holds neither numbers nor words")
