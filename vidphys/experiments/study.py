"""A study: tables by name, cell by cell, and the verdict on every pre-registered row."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from registry import unknown
from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core.bars import ABSENT, Verdict, bars_hash, judge, rows_of, with_remark
from vidphys.experiments.core.cell import CellTask, Kept, Report, Table, Unit
from vidphys.experiments.pixels.pixel_cell import PixelCell
from vidphys.perception.catalogue import rung_settings
from vidphys.presets import Preset
from vidphys.runs.atomic import write_json
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import merged_tables

ALL, PIXELS = "all", "pixels"  # the tables that need no pictures, and those that do


def choose(names: Sequence[str]) -> tuple[Table, ...]:
    """Tables by name, in the order of the catalogue; those of an import path come last.

    ``all`` means every table that needs no pictures, ``pixels`` every one that does, but for
    those that stand apart.

    Raises:
        UnknownName: there is none of this name; the nearest spelling is given.
    """
    named = [TABLES[name] for name in names if name not in (ALL, PIXELS)]
    listed = [
        table
        for table in TABLES.values()
        if table in named or (not table.apart and (PIXELS if table.pixels else ALL) in names)
    ]
    return (*listed, *(table for table in named if table not in listed))


def units_of(tables: Sequence[Table], seeds: int, cells: Sequence[str] = ()) -> list[Unit]:
    """The cells that the tables need, each once, those of a table together.

    Args:
        tables: see :func:`choose`.
        seeds: how many.
        cells: only these; all if none is named.

    Raises:
        UnknownName: none of the tables has a cell of this name.
        ValueError: no seed.
    """
    if seeds < 1:
        raise ValueError(f"units_of: seeds = {seeds}: at least one seed is needed")
    sources = list({id(source): source for source in map(_source, tables)}.values())
    for cell in cells:
        if not any(cell in table.cells for table in sources):
            raise unknown("cell", cell, [name for table in sources for name in table.cells])
    units = []
    names = {id(table): name for name, table in TABLES.items()}
    for table in sources:
        asked = [cell for cell in table.cells if not cells or cell in cells]
        asked += [cell for cell in cells if cell in table.cells and cell not in asked]
        found = table.units(asked, tuple(range(seeds)))
        units += [replace(unit, table=names[id(table)]) for unit in found]
    return units


def _source(table: Table) -> Table:
    """The table whose records are read."""
    return TABLES[table.source] if table.source else table


def settings_of(
    verb: str, preset_name: str, preset: Preset, units: Sequence[Unit], tables: Iterable[Table]
) -> dict[str, Any]:
    """What makes a run this run, as it stands in ``run.json``.

    Args:
        verb: of the command line.
        preset_name, preset: the sizes.
        units: what is done.
        tables: whose settings, and whose bars' hash, are part of it.
    """
    about = {table.name: dict(table.settings) for table in tables}
    cells = [TABLES[unit.table].cells[cell] for unit in units for cell in unit.cells]
    rungs = [cell.grounding for cell in cells if isinstance(cell, PixelCell)]
    return {
        "experiment": verb,
        "preset": preset_name,
        "sizes": asdict(preset),
        "seeds": sorted({seed for unit in units for seed in unit.seeds}),
        "cells": sorted({f"{unit.table}/{cell}" for unit in units for cell in unit.cells}),
        "bars_sha256": bars_hash(about),
        "tables": about,
        "rungs": rung_settings(rungs) if rungs else {},
        "dtype": "float32",
    }


def run_unit(path: Path, unit: Unit, preset: Preset, device: str, report: Report) -> None:
    """Do what is left of one unit, and keep each cell's tables as it is finished.

    Args:
        path: the run folder.
        unit: cells and seeds of a table.
        preset: sizes.
        device: where to train.
        report: called as ``(stage, step, steps)``.
    """
    run, table, kept = RunFolder(path), TABLES[unit.table], Kept()
    for cell, part in zip(unit.cells, unit.parts, strict=True):
        if run.is_done(part):
            continue
        task = CellTask(
            table.name,
            cell,
            unit.seeds,
            preset.oracle,
            preset.pixel,
            device,
            run.checkpoints(part),
            _named(part, report),
            run.showcase(cell),
            kept,
        )
        began = time.perf_counter()
        table.cells[cell](task)
        if not task.recorders:
            raise RuntimeError(f"{unit.table}/{cell}: the cell left no record")
        for recorder in task.recorders:
            recorder.took(time.perf_counter() - began)
        run.finish(part, *merged_tables(task.recorders))


def _named(part: str, report: Report) -> Report:
    def say(stage: str, step: int, steps: int) -> None:
        report(f"{part}: {stage}" if stage else part, step, steps)

    return say


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
    for cell in _source(table).cells:
        asked = any(f"{name}/".startswith(f"{cell}/") for name in (row.cell, row.divided_by or ""))
        reason = reasons.get(f"{table.records_of}/{cell}")
        if asked and reason:
            return replace(verdict, why=reason)
    return verdict
