"""A ladder by processes of this machine and by Ray: seconds beside each other and beside the plan.

Run from a checkout: ``python -m benchmarks.engines FOLDER CELL [CELL …]``, with nothing beside it.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from vidphys.experiments.core.cell import Unit
from vidphys.experiments.costs import known_costs, pace_here
from vidphys.experiments.forecast import forecast
from vidphys.experiments.ladder import LADDER
from vidphys.experiments.study import units_of
from vidphys.presets import preset
from vidphys.runs.cost import cost_of
from vidphys.runs.engine import EngineName
from vidphys.runs.records import read_table
from vidphys.runs.schedule import makespan

ENGINES: tuple[EngineName, ...] = ("local", "ray")
SEEDS, WORKERS = 2, 2


def planned(units: Sequence[Unit], engine: EngineName, measured: Sequence[Path] = ()) -> float:
    """Seconds that the plan says, by ours of the units' times or by those of a run."""
    pace = pace_here(WORKERS)
    known = known_costs(measured, pace=pace)
    return forecast(units, "quick", preset("quick"), known, engine, pace).wall(WORKERS)


def timed(engine: EngineName, cells: Sequence[str], folder: Path) -> float:
    """Seconds of the whole command by the clock."""
    asked = ["--cells", *cells, "--seeds", str(SEEDS), "--workers", str(WORKERS)]
    command = [sys.executable, "-m", "vidphys", "ladder", *asked, "--engine", engine]
    began = time.monotonic()
    subprocess.run([*command, "--out", str(folder), "--quiet"], check=True, stdout=sys.stderr)
    return time.monotonic() - began


def took(unit: Unit, folder: Path) -> float:
    """Seconds of a unit, as its own process measured it."""
    parts = (read_table(folder / "parts" / f"{part}.records.parquet") for part in unit.parts)
    return sum(cost.seconds for part in parts if (cost := cost_of(part)) is not None)


def run(folder: Path, cells: Sequence[str]) -> None:
    """Print a line of JSON for each engine: what is not ``units`` is start and report."""
    units = units_of([LADDER], range(SEEDS), list(cells))
    for engine in ENGINES:
        foretold, here = planned(units, engine), folder / engine
        seconds = timed(engine, cells, here)
        each = [took(unit, here) for unit in units]
        found = {
            "engine": engine,
            "seconds": seconds,
            "units": makespan(each, WORKERS),
            "each": each,
            "planned": foretold,
            "planned_by_itself": planned(units, engine, [here]),
        }
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    run(Path(sys.argv[1]), sys.argv[2:])
