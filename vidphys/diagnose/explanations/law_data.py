"""Fitted laws as a file keeps them: numbers, units and rivals, to be read by a program."""

from __future__ import annotations

from typing import Any

import numpy as np

from vidphys.diagnose.explanations.equations import of_law
from vidphys.diagnose.mechanisms.charts import Arc
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.mechanism import Group
from vidphys.diagnose.mechanisms.quantities import Quantity, quantities
from vidphys.diagnose.recordings.units import Units

RIVALS = 5  # that are kept
FIXED = {"centre": "centre", "elastic": "pivot", "string": "pivot"}  # places that laws fix


def as_data(group: Group, units: Units) -> dict[str, Any]:
    """A law of some bodies, its numbers with their errors, and the laws that are nearly as likely.

    Args:
        group: of the bodies.
        units: in which lengths are told.
    """
    fit, chart = group.fit, group.fit.model.charts[0]
    known = quantities(fit, units.ends)
    held: dict[str, Any] = {
        "bodies": list(group.bodies),
        "moves on": chart.name,
        "restoring": fit.model.law.restoring,
        "friction": fit.model.law.friction,
        "walls": len(fit.model.law.walls),
        "quantities": {x.name: told_as_data(x, units) for x in known},
        "equation": of_law(fit, (x.name for x in known)).data,
        "errors": {
            "white": units.told(fit.errors.white, 1),
            "smooth": units.told(fit.errors.smooth, 1),
            "memory_seconds": fit.errors.memory,
        },
        "log_likelihood": fit.log_likelihood,
        "others": [
            {
                "moves on": x.model.charts[0].name,
                "terms": sorted(x.model.law.kinds),
                "less_likely_by": fit.score - x.score,
            }
            for x in group.others[:RIVALS]
        ],
    }
    if isinstance(chart, Arc):
        pivot = chart.pivot(fit.geometry[0])
        held["pivot"] = [units.told(float(x), 1) for x in pivot]
    if fit.model.law.restoring in FIXED:
        place = np.tile(fit.model.law.centre(fit.numbers), len(fit.model.charts))
        told = [units.told(float(x), 1) for x in fit.shown(place[None])[0, 0]]
        held[FIXED[fit.model.law.restoring]] = told
    return held


def told_as_data(x: Quantity, units: Units) -> dict[str, Any]:
    """A number with its error in the unit in which lengths are told, and that unit."""
    error = units.told(x.error, x.length)
    return {
        "value": units.told(x.value, x.length),
        "standard_error": error if np.isfinite(error) else None,
        "unit": units.named(x.length, x.seconds),
        "known": x.known,
    }


def wall_of(fit: Fit) -> dict[str, Any] | None:
    """Across which axis the first wall stands, and where, unit of the positions."""
    law = fit.model.law
    if not law.walls:
        return None
    normal = law.walls[0].turned(fit.numbers.get("turn 1", (0.0, 0.0))[0])
    place = fit.numbers["wall 1"][0]
    on, beyond = (fit.shown(x * normal[None])[0, 0] for x in (place, 1.01 * place + 1e-6))
    axis = int(np.abs(beyond - on).argmax())
    return {"axis": "xyz"[axis], "place": float(on[axis])}
