"""A study: tables by name, cell by cell, and the verdict on every pre-registered row."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

from registry import unknown
from vidphys.devices import prepare_device
from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core.bars import (
    ABSENT,
    MISSED,
    SKIPPED,
    UNASKED,
    Row,
    Verdict,
    bars_hash,
    judge,
    rows_of,
    with_remark,
)
from vidphys.experiments.core.cell import CellTask, Kept, OfRung, Report, Table, Unit
from vidphys.perception.catalogue import rung_settings
from vidphys.presets import Preset
from vidphys.runs.asked import asked_of
from vidphys.runs.code import modules_of
from vidphys.runs.cost import Cost, peak_memory
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import merged_tables
from vidphys.runs.sealed import write_sealed
from vidphys.seeding import of_roles

T = TypeVar("T")
VERDICTS = 2  # schema of verdicts.json; 1 had no seal
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


def units_of(
    tables: Sequence[Table], seeds: Sequence[int], cells: Sequence[str] = ()
) -> list[Unit]:
    """The cells that the tables need, each once, those of a table together.

    Args:
        tables: see :func:`choose`.
        seeds: each once.
        cells: only these; all if none is named.

    Raises:
        UnknownName: none of the tables has a cell of this name.
        ValueError: no seed.
    """
    if not seeds:
        raise ValueError("units_of: `seeds` is empty: at least one seed is needed")
    sources = list({id(source): source for source in map(_source, tables)}.values())
    for cell in cells:
        if not any(cell in table.cells for table in sources):
            raise unknown("cell", cell, [name for table in sources for name in table.cells])
    units = []
    for table in sources:
        asked = [cell for cell in table.cells if not cells or cell in cells]
        asked += [cell for cell in cells if cell in table.cells and cell not in asked]
        found = table.units(asked, tuple(seeds))
        units += [replace(unit, table=_name_of(table)) for unit in found]
    return units


def _name_of(table: Table) -> str:
    """By which the catalogue gives a table; of one from outside, its import path."""
    return next((name for name, each in TABLES.items() if each is table), table.name)


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
    cells: list[object] = [TABLES[u.table].cells[cell] for u in units for cell in u.cells]
    rungs = [cell.grounding for cell in cells if isinstance(cell, OfRung)]
    asked: dict[str, list[int]] = {}
    for unit in units:
        for cell in unit.cells:
            seeds = {*asked.get(f"{unit.table}/{cell}", ()), *unit.seeds}
            asked[f"{unit.table}/{cell}"] = sorted(seeds)
    return {
        "experiment": verb,
        "preset": preset_name,
        "sizes": asdict(preset),
        "seeds": sorted({seed for unit in units for seed in unit.seeds}),
        "cells": sorted({f"{unit.table}/{cell}" for unit in units for cell in unit.cells}),
        "asked": asked,
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
        device: where to train and roll.
        report: called as ``(stage, step, steps)``.
    """
    prepare_device(device)  # again: a worker is a process of its own
    run, table, kept = RunFolder(path), TABLES[unit.table], Kept()
    asked = asked_of(run.manifest()["settings"])
    for cell, part in zip(unit.cells, unit.parts, strict=True):
        if run.is_done(part):
            continue
        seeds = of_roles(asked.get(f"{unit.table}/{cell}") or unit.seeds)
        shown = next(iter(seeds.values()))[0]  # of confirmation, where there is one
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
            shown,
            kept,
        )
        began = time.perf_counter()
        table.cells[cell](task)
        if not task.recorders:
            raise RuntimeError(f"{unit.table}/{cell}: the cell left no record")
        for recorder in task.recorders:
            recorder.took(time.perf_counter() - began)
        makers = {*modules_of(table.cells[cell]), table.module} - {""}
        cost = Cost(time.perf_counter() - began, peak_memory())
        run.finish(part, *merged_tables(task.recorders), tuple(sorted(makers)), cost)


def _named(part: str, report: Report) -> Report:
    def say(stage: str, step: int, steps: int) -> None:
        report(f"{part}: {stage}" if stage else part, step, steps)

    return say


def write_verdicts(run: RunFolder, tables: Sequence[Table]) -> dict[str, Any]:
    """Hold what was recorded to the rows of each table; kept as ``verdicts.json``.

    A row of a cell that was skipped says why, one of a cell that was left out says that. One of a
    cell that was asked for is held to every seed that it was asked for: to those of confirmation
    first, and to those of development apart.
    """
    records = run.join().to_pylist()
    manifest = run.manifest()
    reasons = {entry["cell"]: entry["reason"] for entry in manifest["skipped"]}
    asked = {cell: of_roles(seeds) for cell, seeds in asked_of(manifest["settings"]).items()}
    roles = of_roles({*manifest["settings"]["seeds"], *(r["seed"] for r in records)})
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
                asdict(with_remark(table.name, verdict))
                for role in roles
                for verdict in _of_role(role, table, mine, asked, reasons)
            ],
        }
    write_sealed(run.path / "verdicts.json", found, VERDICTS)
    return found


def _of_role(
    role: str,
    table: Table,
    records: Sequence[Mapping[str, Any]],
    asked: Mapping[str, Mapping[str, Sequence[int]]],
    reasons: Mapping[str, str],
) -> Iterator[Verdict]:
    """The verdicts on a table's rows by the seeds of one role, of what was asked for under it."""
    source = _name_of(_source(table))
    mine = [record for record in records if record["role"] == role]
    for row in rows_of(table.name):
        seeds = _of_cell(asked, source, row.cell) or {}
        if seeds and role not in seeds:
            continue  # the cell was asked for under the other role alone
        verdict = _judged(row, mine, source, seeds.get(role, ()), asked, reasons)
        cells = (row.cell, row.divided_by)
        stale = any(record["stale"] and record["cell"] in cells for record in mine)
        yield replace(verdict, role=role, stale=stale)


def _judged(
    row: Row,
    records: Sequence[Mapping[str, Any]],
    source: str,
    seeds: Sequence[int],
    asked: Mapping[str, object],
    reasons: Mapping[str, str],
) -> Verdict:
    """A row's verdict; one without any number says what became of its cells."""
    verdict = judge(row, records, seeds)
    if verdict.values:
        return verdict
    cells = [cell for cell in (row.cell, row.divided_by) if cell is not None]
    for cell in cells:
        reason = _of_cell(reasons, source, cell)
        if reason is not None:
            skipped = reason.startswith(SKIPPED) or verdict.verdict == ABSENT
            return replace(verdict, why=reason, verdict=ABSENT if skipped else MISSED)
    if not all(_of_cell(asked, source, cell) for cell in cells):
        return Verdict(row, {}, None, UNASKED)
    return verdict


def _of_cell(found: Mapping[str, T], table: str, name: str) -> T | None:
    """What is said of the cell that a row's name is of, or is a part of."""
    whole = f"{table}/{name}"
    places = [key for key in found if f"{whole}/".startswith(f"{key}/")]
    return found[max(places, key=len)] if places else None
