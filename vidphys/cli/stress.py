"""``vidphys stress``: the extremes, each sound, warned of or refused, and never silently wrong."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from vidphys.cli.console import Console


@dataclass(frozen=True)
class StressConfig:
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
        0, or 1 if a cell is silently wrong.

    Raises:
        InputError: an unknown axis, or a run folder that holds something else.
    """
    import torch

    from vidphys.runs.folder import RunFolder
    from vidphys.stress.case import SILENT
    from vidphys.stress.figures import MET, NOT_MEASURED
    from vidphys.stress.matrix import (
        PRESETS,
        families,
        load_family,
        run_family,
        settings_of,
        write_verdicts,
    )
    from viz.stress import write_stress_report

    torch.set_num_threads(1)
    settings = settings_of(config.preset, config.axes)
    outcomes = []
    with ExitStack() as stack:
        run = stack.enter_context(RunFolder.at_work(config.out, settings, config.overwrite))
        chosen = run.manifest()["settings"]["cells"]
        cells = {k: v for k, v in families(PRESETS[config.preset]).items() if k in chosen}
        console = stack.enter_context(Console(config.quiet, len(cells), "stress"))
        for index, (name, cases) in enumerate(cells.items()):
            if run.is_done(name):
                outcomes += load_family(run, name, cases)
            else:

                def show(done: int, name: str = name, count: int = len(cases)) -> None:
                    console.stage((name, done, count))

                outcomes += run_family(run, name, cases, show)
            console.done(index)
        run.join()
        verdicts = write_verdicts(run, outcomes)
        report = write_stress_report(run.path)
        for outcome in outcomes:
            if outcome.verdict == SILENT:
                console.warn(f"silently wrong: {outcome.case.name}: {outcome.error} {outcome.said}")
        counts = ", ".join(f"{count} {verdict}" for verdict, count in verdicts["counts"].items())
        figures = [row["verdict"] for row in verdicts["figures"]]
        console.result(
            f"{len(outcomes)} cells: {counts}; figures A1-A30: {figures.count(MET)} met, "
            f"{figures.count(NOT_MEASURED)} not measured; report: {report}"
        )
    return 1 if SILENT in verdicts["counts"] else 0
