"""Why there is no formula, and which recording would tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.formula.formula import ALIKE, Formula, Verdict

FARTHER = 1.0  # of the width that was seen, up to which a recording may reach farther
APART = 0.2  # of the force's spread, by which two formulas must differ to be told apart there
FEW = "no formula: the same swing over and over tells too little of a force"
ELSE = (
    "no law of its place and speed alone rolls along the recording; one that also shows what else "
    "acts (a drive, a second body, another coordinate) would tell"
)


def would_tell(verdict: Verdict, low: float, high: float) -> str:
    """The reason of a refusal, with the recording that would end it.

    Args:
        verdict: without a formula.
        low, high: places that were seen.
    """
    if verdict.why == FEW:
        return f"{verdict.why}; a recording of swings of several heights would tell"
    if verdict.why != ALIKE:
        return (
            f"{verdict.why}; a recording that reaches beyond {low:.3g} to {high:.3g} would show "
            "more of its force"
        )
    told = ", ".join(one.text for one in verdict.rivals)
    place = parting(verdict.rivals, low, high)
    where = "with less noise" if place is None else f"that reaches {place:.3g}"
    return f"{verdict.why} ({told}); a recording {where} would tell"


def parting(formulas: Sequence[Formula], low: float, high: float) -> float | None:
    """The nearest place beyond those that were seen at which formulas differ."""
    width = high - low
    inside = np.linspace(low, high, 50)
    clear = APART * float(np.std(formulas[0].at(inside)))
    beyond = np.linspace(0, FARTHER * width, 41)[1:]
    down, up = low - beyond, high + beyond
    if low > 0:
        down = down[down > 0.2 * low]
    found = []
    for places in (up, down):
        if len(places) == 0:
            continue
        apart = np.ptp(np.stack([one.at(places) for one in formulas]), axis=0) > clear
        found += [float(places[int(apart.argmax())])] if apart.any() else []
    return min(found, key=lambda x: max(low - x, x - high), default=None)
