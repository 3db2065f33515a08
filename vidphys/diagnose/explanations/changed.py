"""Laws that were never recorded: fitted ones with some of their numbers changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.mechanism import Mechanism
from vidphys.diagnose.mechanisms.terms import RATES

FINELY = 200  # steps at least from a clip's beginning to where a law is changed


def asked_of(mechanism: Mechanism) -> dict[str, dict[str, float]]:
    """What may be changed of the laws: factors by the beginning of a number's name."""
    kinds = mechanism.kinds
    asked: dict[str, dict[str, float]] = {}
    if kinds & set(RATES):
        asked["no friction"] = {name: 0.0 for name in RATES}
    if "pendulum" in kinds:
        asked["half the length"] = {"swing": 2.0}
    elif {"trap", "pair"} <= kinds:  # with those between them, or they would rest elsewhere
        asked["twice the stiffness"] = {"stiffness": 2.0, "force": 2.0, "coupling": 2.0}
    elif "trap" in kinds:
        asked["twice the stiffness"] = {"stiffness": 2.0, "force": 2.0}
    elif "elastic" in kinds:
        asked["twice the stiffness"] = {"stiffness": 2.0}
    elif "centre" in kinds:
        asked["twice the strength"] = {"strength": 2.0}
    elif kinds & {"uniform", "string"}:
        asked["twice the field"] = {"force": 2.0}
    if "collision" in kinds:
        asked["a second body of twice the mass"] = {"mass 2": 2.0}
    if "lift" in kinds:
        asked["no spin"] = {"lift": 0.0}
    if "forcing" in kinds:
        asked["nothing that drives it"] = {"forcing": 0.0}
    if "turning" in kinds:
        asked["nothing that turns it"] = {"turning": 0.0}
    if "input" in kinds:
        asked["nothing that pushes it"] = {"gain": 0.0}
    return asked


@np.errstate(all="ignore")  # a law without its friction may fly apart
def under(fit: Fit, factors: dict[str, float], start: float, since: np.ndarray) -> np.ndarray:
    """Places ``(t, n, d)`` under changed numbers, from the fit's own state at ``start`` seconds."""
    numbers, starts = fit.model.split(fit.values, len(fit.clips))
    known = fit.clips[-1].inputs
    until = np.linspace(0.0, max(start, 1e-9), FINELY)
    state = fit.model.law.roll(numbers, starts[-1], until, known)[-1]
    changed = fit.model.law.later(numbers, start)
    for i, name in enumerate(fit.model.law.names):
        changed[i] *= next((x for key, x in factors.items() if name.startswith(key)), 1.0)
    law = replace(fit.model.law, nears=False)
    kept = [i for i, name in enumerate(fit.model.law.names) if name != "nearing"]
    ahead = None if known is None else known.since(start)
    rolled = law.roll(changed[kept], state, since, ahead)[:, 0]
    return fit.shown(rolled)
