"""``reproduce``: the study's tables, cell by cell, and the verdict on every pre-registered row."""

from __future__ import annotations

import difflib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch

from vidphys.errors import InputError
from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core.bars import (
    ABSENT,
    Verdict,
    bars_hash,
    judge,
    rows_of,
    with_remark,
)
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.presets import Preset
from vidphys.runs.atomic import write_json
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import merged_tables

ALL, PIXELS = "all", "pixels"  # the tables that need no pictures, and those that do


@dataclass(frozen=True)
class Unit:
    """What one worker does in one go: a cell of a table, with all its seeds."""

    table: str
    cell: str
    seeds: tuple[int, ...]

    @property
    def part(self) -> str:
        """Name of the piece of work; other seeds make another piece."""
        seeds = "-".join(map(str, self.seeds))
        return f"{self.table}.{self.cell.replace('/', '-')}.s{seeds}"


def choose(names: Sequence[str]) -> tuple[Table, ...]:
    """Tables by name, in the order of the catalogue.

    ``all`` means every table that needs no pictures, ``pixels`` every one that does.

    Raises:
        InputError: an unknown name; the nearest spelling is given.
    """
    for name in names:
        if name not in (ALL, PIXELS, *TABLES):
            near = difflib.get_close_matches(name, TABLES, n=1)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            raise InputError(f"reproduce {name}: no such table{hint} Known: {', '.join(TABLES)}")
    return tuple(
        table
        for table in TABLES.values()
        if table.name in names or (PIXELS if table.pixels else ALL) in names
    )


def units_of(tables: Sequence[Table], seeds: int, cells: Sequence[str] = ()) -> list[Unit]:
    """The cells that the tables need, each once, those of a table together.

    Args:
        tables: see :func:`choose`.
        seeds: how many.
        cells: only these; all if none is named.

    Raises:
        InputError: none of the tables has a cell of this name.
    """
    sources = dict.fromkeys(table.records_of for table in tables)
    pairs = [(name, cell) for name in sources for cell in TABLES[name].cells]
    for cell in cells:
        known = [c for _, c in pairs]
        if cell not in known:
            near = difflib.get_close_matches(cell, known, n=1)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            raise InputError(f"--cells {cell}: no such cell in {', '.join(sources)}{hint}")
    numbers = tuple(range(seeds))
    return [Unit(name, cell, numbers) for name, cell in pairs if not cells or cell in cells]


def settings_of(preset_name: str, preset: Preset, units: Sequence[Unit], seeds: int) -> Any:
    """What makes a run this run; the hash of the bars is part of it."""
    return {
        "experiment": "reproduce",
        "preset": preset_name,
        "sizes": asdict(preset.oracle),
        "pixel_sizes": asdict(preset.pixel),
        "seeds": list(range(seeds)),
        "cells": sorted(f"{unit.table}/{unit.cell}" for unit in units),
        "bars_sha256": bars_hash(),
        "tables": {t.name: dict(t.settings) for t in TABLES.values()},
        "dtype": "float32",
    }


Report = Callable[[str, int, int], None]


def run_unit(path: Path, unit: Unit, preset: Preset, device: str, report: Report) -> None:
    """Do one cell, unless it is done, and keep its tables.

    Args:
        path: the run folder.
        unit: table, cell and seeds.
        preset: sizes.
        device: where to train.
        report: called as ``(stage, step, steps)``.
    """
    torch.set_num_threads(1)
    run = RunFolder(path)
    if run.is_done(unit.part):
        return
    name = f"{unit.table}/{unit.cell}"
    task = CellTask(
        unit.table,
        unit.cell,
        unit.seeds,
        preset.oracle,
        preset.pixel,
        device,
        run.checkpoints(unit.part),
        lambda step, steps, _loss: report(name, step, steps),
    )
    began = time.perf_counter()
    TABLES[unit.table].cells[unit.cell](task)
    if not task.recorders:
        raise RuntimeError(f"{name}: the cell left no record")
    seconds = time.perf_counter() - began
    for recorder in task.recorders:
        recorder.took(seconds)
    run.finish(unit.part, *merged_tables(task.recorders))


def write_verdicts(run: RunFolder, tables: Sequence[Table]) -> dict[str, Any]:
    """Hold what was recorded to the rows of each table; kept as ``verdicts.json``.

    A row of a cell that was skipped says why.
    """
    records = run.join().to_pylist()
    reasons = {entry["cell"]: entry["reason"] for entry in run.manifest()["skipped"]}
    found: dict[str, Any] = {}
    for table in tables:
        mine = [r for r in records if r["experiment"] == table.records_of]
        found[table.name] = {
            "title": table.title,
            "about": table.about,
            "ids": table.ids,
            "records_of": table.records_of,
            "sweeps": [asdict(sweep) for sweep in table.sweeps],
            "rows": [
                asdict(with_remark(table.name, _explained(judge(row, mine), table, reasons)))
                for row in rows_of(table.name)
            ],
        }
    write_json(run.path / "verdicts.json", found)
    return found


def _explained(verdict: Verdict, table: Table, reasons: Mapping[str, str]) -> Verdict:
    """A row without a number, with the reason that its cell was not run."""
    row = verdict.row
    if verdict.verdict != ABSENT:
        return verdict
    for cell in TABLES[table.records_of].cells:
        asked = any(f"{name}/".startswith(f"{cell}/") for name in (row.cell, row.divided_by or ""))
        reason = reasons.get(f"{table.records_of}/{cell}")
        if asked and reason:
            return replace(verdict, why=reason)
    return verdict
