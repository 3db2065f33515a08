"""What a stripe parts: two pieces of one colour that turn about their middle as one."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from binders.hypotheses import Hypothesis

AS_LARGE = 1.25  # times the other's size
BESIDE = 2.5  # sizes, within which the other is the rest of the same body
RIGID = 0.1  # of their distance, by which it may vary
TURNED = 0.2  # radians from first to last, at least: what does not turn need not be one
MOSTLY = 0.75  # of the frames, in which both are seen


def halves(pieces: list[Hypothesis]) -> list[Hypothesis]:
    """Bodies of which two of the pieces are the halves.

    Args:
        pieces: what was followed of one colour.
    """
    pairs = combinations(pieces, 2)
    return [_joined(one, other) for one, other in pairs if _of_one(one, other)]


def _of_one(one: Hypothesis, other: Hypothesis) -> bool:
    both = one.seen & other.seen
    sizes = one.usual_size, other.usual_size
    if both.mean() < MOSTLY or max(sizes) > AS_LARGE * min(sizes):
        return False
    between = one.positions[both] - other.positions[both]
    apart = np.linalg.norm(between, axis=-1)
    turned = np.unwrap(np.arctan2(between[:, 1], between[:, 0]))
    return bool(
        0 < np.median(apart) < BESIDE * np.mean(sizes)
        and apart.std() < RIGID * apart.mean()
        and np.ptp(turned) > TURNED
    )


def _joined(one: Hypothesis, other: Hypothesis) -> Hypothesis:
    size = np.hypot(one.size, other.size)
    return replace(
        one,
        positions=(one.positions + other.positions) / 2,
        energy=one.energy + other.energy,
        size=size,
        radius=size,
        compact=np.minimum(one.compact, other.compact),
        lit=np.maximum(one.lit, other.lit),
    )
