"""Kinds of terms for which one stretch of the recording alone speaks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.inference.structures import Menu, Structure
from vidphys.diagnose.weak.regression import Rows

LEAST = 5.0  # gain of log likelihood, that a kind must have where it has not its most
FEWEST = 8  # windows; of fewer, one may well be what speaks for a term that is there
MANY = 24  # windows, from which one and those beside it are one stretch: a moment may lie in all


def of_one_stretch(
    menu: Menu, rows: Rows, structures: Sequence[Structure], ratio: float
) -> frozenset[str]:
    """Kinds of the best structure that few would miss if one stretch had not been recorded.

    That is a window, where there are many with its neighbours.

    Each is held against the best structure without it that has no more numbers: a trap far away is
    a uniform field, with one more. What a false find or a swapped name leaves looks like a force in
    one window. A recording of few windows is not asked.

    Args:
        menu: whose terms the structures have.
        rows: of the menu's columns.
        structures: best first.
        ratio: of random kicks, see :class:`vidphys.diagnose.inference.residual.Kicks`.
    """
    best, count = structures[0], len(np.unique(rows.window))
    if count < FEWEST:
        return frozenset()
    weight = 1 / (1 + ratio * rows.kicks)
    least = _squares(menu, rows, best) * weight
    unit = 2 * max(float(least.mean()), np.finfo(float).tiny)
    simple = [s for s in structures if s.numbers <= best.numbers]
    found = set()
    for kind in best.kinds:
        without = next((other for other in simple if kind not in other.kinds), None)
        if without is not None:
            gain = (_squares(menu, rows, without) * weight - least) / unit
            by_window = np.bincount(rows.window, gain)
            by_stretch = np.convolve(by_window, np.ones(3 if count >= MANY else 1), "same")
            if by_window.sum() - by_stretch.max() < LEAST:
                found.add(kind)
    return frozenset(found)


def _squares(menu: Menu, rows: Rows, structure: Structure) -> np.ndarray:
    """Squared residuals, ``(r,)``."""
    places = menu.places
    chosen = [place for term in structure.terms for place in places[menu.terms.index(term)]]
    left: np.ndarray = (rows.y - rows.x[:, chosen] @ structure.coefficients) ** 2
    return left
