"""``vidphys plan``: what a study will cost, before it is run."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from vidphys.cli.study import StudyOptions, option
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.experiments.core.cell import Unit
    from vidphys.experiments.forecast import Forecast
    from vidphys.runs.cost import Cost

CLUSTERS = (1, 2, 8, 64)  # workers that a plan is told for, beside those that are asked for


@dataclass(frozen=True)
class PlanConfig(StudyOptions):
    """Print the units of a study, what each takes, and how long all of them take side by side.

    Example: vidphys plan ladder --preset standard --workers 8

    Example: vidphys plan reproduce stability inversion --measured runs/tables

    Args:
        verb: whose plan it is.
        tables: those of `vidphys reproduce`.
        cells: as `vidphys help ladder` and `vidphys help reproduce` say.
        heads, scene: as `vidphys help ladder` says.
        units: print each unit, too.
        json: print all of it as JSON, for a script: seconds, by the clock for so many workers.
    """

    verb: Annotated[Literal["ladder", "reproduce"], tyro.conf.Positional]
    tables: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    cells: tuple[str, ...] = ()
    heads: tuple[str, ...] = ()
    scene: str = ""
    units: bool = False
    json: bool = False


def plan(config: PlanConfig) -> int:
    """Print what the verb would do, and how long it would take.

    Returns:
        0.

    Raises:
        InputError: as the verb itself, or a folder of measured units that is no run.
    """
    from vidphys.experiments.costs import known_costs, pace_here
    from vidphys.experiments.forecast import forecast, told_seconds
    from vidphys.experiments.study import units_of

    sizes, seeds = config.sizes()
    tables, cells = _asked(config)
    with option("--cells"):
        units = units_of(tables, seeds, cells)
    pace = pace_here(config.workers)
    known = known_costs(config.measured, config.device, pace)
    found = forecast(units, config.preset, sizes, known, config.engine, pace)
    if config.json:
        print(json.dumps(_as_data(found, config.workers)))
        return 0
    if config.units:
        for unit, cost in found.units.items():
            print(_line(unit, cost))
    print(found.sentence(config.workers))
    if found.peak_bytes:
        print(f"memory: {found.peak_bytes / 2**30:.1f} GiB a worker at most")
    for workers, seconds in _walls(found, config.workers).items():
        print(f"{workers:>4} workers  {told_seconds(seconds)}")
    return 0


def _walls(found: Forecast, workers: int) -> dict[int, float]:
    """Seconds by the clock, for numbers of workers."""
    return {n: found.wall(n) for n in sorted({*CLUSTERS, workers})} if found.seconds else {}


def _as_data(found: Forecast, workers: int) -> dict[str, Any]:
    return {
        "units": [
            {
                "table": unit.table,
                "cells": unit.cells,
                "seeds": unit.seeds,
                "seconds": None if cost is None else cost[0].seconds,
                "how": "not known" if cost is None else cost[1],
            }
            for unit, cost in found.units.items()
        ],
        "seconds": sum(found.seconds),
        "unknown": found.unknown,
        "peak_bytes": found.peak_bytes,
        "pace": found.pace,
        "wall": _walls(found, workers),
    }


def _asked(config: PlanConfig):  # noqa: ANN202 (tables and cells)
    from vidphys.experiments.ladder import LADDER, cells_of
    from vidphys.experiments.study import choose

    if config.verb == "ladder":
        with option("--cells, --scene"):
            return [LADDER], cells_of(config.cells, config.heads, config.scene)
    if not config.tables:
        raise InputError("plan reproduce: name a table, or all")
    with option("plan"):
        return choose(config.tables), config.cells


def _line(unit: Unit, found: tuple[Cost, str] | None) -> str:
    from vidphys.experiments.forecast import told_seconds

    cells = unit.cells[0] + (f" and {len(unit.cells) - 1} more" if len(unit.cells) > 1 else "")
    seeds = ",".join(map(str, unit.seeds))
    took = "not known" if found is None else f"{told_seconds(found[0].seconds)} ({found[1]})"
    return f"{unit.table:<24}{cells:<56}{'seeds ' + seeds:<14}{took}"
