"""``vidphys reproduce``: the study's tables, row by row against their bars."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from vidphys.cli.console import Console
from vidphys.cli.profiles import with_profile
from vidphys.cli.study import StudyOptions, option, run_study
from vidphys.errors import InputError


@dataclass(frozen=True)
class ReproduceConfig(StudyOptions):
    """Regenerate tables of the study from raw records, with their verdicts.

    Example: vidphys reproduce stability inversion --preset quick --out runs/tables

    Args:
        tables: names of tables; all: those that need no pictures; pixels: those that do.
        out: the run folder; the same command again goes on where it was.
        cells: only these cells of the tables; all if none is named.
    """

    tables: Annotated[tuple[str, ...], tyro.conf.Positional]
    out: Path = Path("runs/reproduce")
    cells: tuple[str, ...] = ()


def reproduce(config: ReproduceConfig) -> int:
    """Run what is left of the tables' cells, then judge every row and write the report.

    Returns:
        0, or 1 if a cell failed; what others found is kept.

    Raises:
        InputError: an unknown table, no seed or worker, a device that is not there, or a run
            folder that holds something else.
    """
    config = with_profile(config, "reproduce")
    from vidphys.experiments.catalogue import TABLES
    from vidphys.experiments.study import choose, settings_of, units_of, write_verdicts
    from vidphys.runs.folder import RunFolder
    from viz.results import write_results

    if not config.tables:
        raise InputError("reproduce: name a table, or all; `vidphys reproduce --help` shows how")
    sizes, seeds = config.sizes()
    config.check_engine()
    with option("reproduce"):
        tables = choose(config.tables)
    with option("--cells"):
        units = units_of(tables, seeds, config.cells)
    settings = settings_of("reproduce", config.preset, sizes, units, TABLES.values())
    with (
        RunFolder.at_work(config.out, settings, config.overwrite, threads=1) as run,
        Console(config.quiet, len(units), "reproduce") as console,
    ):
        failed = run_study(run, units, sizes, config, console)
        verdicts = write_verdicts(run, tables)
        report = write_results(run.path)
        rows = [row for table in verdicts.values() for row in table["rows"]]
        for role in dict.fromkeys(row["role"] for row in rows):
            counts = Counter(row["verdict"] for row in rows if row["role"] == role)
            said = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
            console.result(f"{len(tables)} tables, {role} seeds: {said}")
        console.result(f"report: {report}")
    return 1 if failed else 0
