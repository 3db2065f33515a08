"""``vidphys reproduce``: the study's tables, row by row against their bars."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.devices import check_cuda
from vidphys.cli.profiles import with_profile
from vidphys.errors import InputError


@dataclass(frozen=True)
class ReproduceConfig:
    """Regenerate tables of the study from raw records, with their verdicts.

    Example: vidphys reproduce stability inversion --preset quick --out runs/tables

    Args:
        tables: names of tables; all: those that need no pictures; pixels: those that do.
        out: the run folder; the same command again goes on where it was.
        cells: only these cells of the tables; all if none is named.
        preset: sizes and seeds; quick is minutes on two cores.
        seeds: number of seeds, instead of the preset's.
        workers: processes.
        profile: take what it sets of this verb from a point that `vidphys trade --pick` chose.
        device: where to train.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    tables: Annotated[tuple[str, ...], tyro.conf.Positional]
    out: Path = Path("runs/reproduce")
    cells: tuple[str, ...] = ()
    preset: Literal["quick", "standard", "paper"] = "quick"
    seeds: int | None = None
    workers: int = 2
    profile: Path | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    overwrite: bool = False
    quiet: bool = False


def reproduce(config: ReproduceConfig) -> int:
    """Run what is left of the tables' cells, then judge every row and write the report.

    Returns:
        0, or 1 if a cell failed; what others found is kept. A cell whose encoder's weights are
        not on this machine is skipped, which is no failure.

    Raises:
        InputError: an unknown table, no seed or worker, a device that is not there, or a run
            folder that holds something else.
    """
    config = with_profile(config, "reproduce")
    from encoders.release import WeightsMissing
    from vidphys.experiments.reproduce import (
        choose,
        run_unit,
        settings_of,
        units_of,
        write_verdicts,
    )
    from vidphys.presets import preset
    from vidphys.runs.folder import RunFolder
    from vidphys.runs.pool import run_all
    from viz.results import write_results

    if not config.tables:
        raise InputError("reproduce: name a table, or all; `vidphys reproduce --help` shows how")
    if config.workers < 1:
        raise InputError(f"--workers {config.workers}: at least one process is needed")
    sizes = preset(config.preset)
    seeds = sizes.seeds if config.seeds is None else config.seeds
    if seeds < 1:
        raise InputError(f"--seeds {seeds}: at least one seed is needed")
    check_cuda(config.device)
    tables = choose(config.tables)
    if config.device == "cuda" and any(table.pixels for table in tables):
        raise InputError("--device cuda: tables with pixels compute on the CPU; use --device cpu")
    units = units_of(tables, seeds, config.cells)
    settings = settings_of(config.preset, sizes, units, seeds)
    run = RunFolder.open(config.out, settings, config.overwrite)
    with run.locked(), Console(config.quiet, len(units), "reproduce") as console:
        tasks = [(run.path, unit, sizes, config.device) for unit in units]
        failures = run_all(run_unit, tasks, config.workers, console.stage, console.done)
        failed = 0
        for index, error in failures:
            name = f"{units[index].table}/{units[index].cell}"
            absent = isinstance(error, WeightsMissing)
            failed += not absent
            word = "skipped" if absent else f"failed: {type(error).__name__}"
            run.skip(name, f"{word}: {error}")
            console.warn(f"{name} {word}: {error}")
        verdicts = write_verdicts(run, tables)
        report = write_results(run.path)
        counts = Counter(row["verdict"] for table in verdicts.values() for row in table["rows"])
        said = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
        console.result(f"{len(tables)} tables: {said}; report: {report}")
    return 1 if failed else 0
