"""Bodies that swing in step: each may have a law of its own, or what moves one moves the other."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from vidphys.diagnose.mechanisms.fitted import Fit

ALIKE = 0.99  # correlation of two swings, to or fro, from which they are in step
SWINGS = ("trap", "pendulum")


def in_step(fits: Sequence[Fit]) -> list[tuple[int, int]]:
    """Pairs of laws of one body each that swing in step all the time, by their places among them.

    What is tied together, or hangs from what moves, does so in each of the swings that it has of
    its own; two that have nothing to do with each other, only where they are alike and let go at
    once.
    """
    ways = {i: _way(fit) for i, fit in enumerate(fits) if _swings(fit)}
    return [
        (i, j)
        for (i, one), (j, two) in combinations(ways.items(), 2)
        if len(one) == len(two) and abs(np.corrcoef(one, two)[0, 1]) > ALIKE
    ]


def _swings(fit: Fit) -> bool:
    law = fit.model.law
    return law.restoring in SWINGS and law.coordinates == 1 and not (law.walls or law.inputs)


def _way(fit: Fit) -> np.ndarray:
    """Of all frames, the coordinate ``(t,)``."""
    return np.concatenate([r[:, 0, 0] for r in fit.model.coordinates(fit.values, fit.clips)])
