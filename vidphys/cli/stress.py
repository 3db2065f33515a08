"""``vidphys stress``: the extremes, each sound, warned of or refused, and never silently wrong."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from vidphys.cli.console import Console
from vidphys.cli.units import EngineOptions, run_units


@dataclass(frozen=True)
class StressConfig(EngineOptions):
    """Run the extremes as a matrix against references, with a verdict for each cell.

    Example: vidphys stress --preset quick --out runs/stress

    Args:
        out: the run folder; the same command again goes on where it was.
        preset: quick is a seventh of the cells, within a minute; standard is all of them.
        axes: only these families of cells; all if none is named.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    out: Path = Path("runs/stress")
    preset: Literal["quick", "standard"] = "quick"
    axes: tuple[str, ...] = ()
    overwrite: bool = False
    quiet: bool = False


def stress(config: StressConfig) -> int:
    """Judge what is left of the matrix and write the report.

    Returns:
        0, or 1 if a cell is silently wrong or a family failed; what others found is kept.

    Raises:
        InputError: an unknown axis, no worker, or a run folder that holds something else.
    """
    from vidphys.runs.folder import RunFolder
    from vidphys.stress.case import SILENT
    from vidphys.stress.figures import MET, NOT_MEASURED, PARTLY
    from vidphys.stress.matrix import (
        PRESETS,
        families,
        load_family,
        run_family,
        settings_of,
        units_of,
        write_verdicts,
    )
    from viz.stress import write_stress_report

    config.check_workers()
    config.check_engine()
    settings = settings_of(config.preset, config.axes)
    with ExitStack() as stack:
        run = stack.enter_context(
            RunFolder.at_work(config.out, settings, config.overwrite, threads=1)
        )
        chosen = run.manifest()["settings"]["cells"]
        units = units_of(chosen, config.preset)
        console = stack.enter_context(Console(config.quiet, len(units), "stress"))
        failed = run_units(run, run_family, units, config, console)
        run.join()
        cells = {k: v for k, v in families(PRESETS[config.preset]).items() if run.is_done(k)}
        outcomes = [o for name, cases in cells.items() for o in load_family(run, name, cases)]
        verdicts = write_verdicts(run, outcomes)
        report = write_stress_report(run.path)
        for outcome in outcomes:
            if outcome.verdict == SILENT:
                console.warn(f"silently wrong: {outcome.case.name}: {outcome.error} {outcome.said}")
        counts = ", ".join(f"{count} {verdict}" for verdict, count in verdicts["counts"].items())
        figures = [row["verdict"] for row in verdicts["figures"]]
        console.result(
            f"{len(outcomes)} cells: {counts}; figures A1-A30: {figures.count(MET)} met, "
            f"{figures.count(PARTLY)} met in part, {figures.count(NOT_MEASURED)} not measured; "
            f"report: {report}"
        )
    return 1 if failed or SILENT in verdicts["counts"] else 0
