"""``vidphys report``: a run's report made anew, or several runs beside each other."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from vidphys.errors import InputError

COMPARED = "comparison.html"


@dataclass(frozen=True)
class ReportConfig:
    """Make a run's report anew; of several ladders, a page on which they are compared.

    Example: vidphys report runs/ladder

    Example: vidphys report runs/before runs/after --out runs/compared

    Args:
        runs: folders of runs.
        out: the folder for the comparison, instead of the last run's.
        json: print where the report lies as JSON, for a script.
    """

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    out: Path | None = None
    json: bool = False


def report(config: ReportConfig) -> None:
    """See :class:`ReportConfig`.

    Raises:
        InputError: no run, or one that cannot be read or has no report.
    """
    if not config.runs:
        raise InputError("report: name the folder of a run")
    if config.out is not None and len(config.runs) == 1:
        raise InputError("--out: would have no effect: one run's report lies in its folder")
    try:
        path = _written(config)
    except ValueError as error:
        raise InputError(str(error)) from error
    said = {"report": str(path), "runs": [str(run) for run in config.runs]}
    print(json.dumps(said) if config.json else f"report: {path}")


def _written(config: ReportConfig) -> Path:
    if len(config.runs) == 1:
        return _writer(config.runs[0])(config.runs[0])
    from viz.comparison import write_comparison

    return write_comparison(config.runs, config.out or config.runs[-1])


def _writer(run: Path) -> Callable[[Path], Path]:
    """What writes the report of a run of its kind."""
    from vidphys.runs.folder import RunFolder
    from viz import atlas, results, stress, told, trade
    from viz.report import write_report

    about = RunFolder.existing(run).manifest()
    kinds: dict[str, Callable[[Path], Path]] = {
        "ladder": _ladder,
        "reproduce": results.write_results,
        "trade": trade.write_trade,
        "atlas": atlas.write_atlas,
        "stress": stress.write_stress_report,
        **dict.fromkeys(told.TITLES, told.write_told),
    }
    return kinds.get(str(about["settings"].get("experiment")), write_report)


def _ladder(run: Path) -> Path:
    from vidphys.cli.playing import FILE, write_play
    from viz.report import write_report

    if not (run / FILE).is_file():
        write_play(run)
    return write_report(run)
