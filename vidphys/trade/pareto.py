"""Which measured points no other one beats, and one figure for a whole front."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vidphys.trade.point import Point

DECADES = 12.0  # below the worst point: what an error of exactly zero counts as


def pareto(points: Sequence[Point]) -> list[Point]:
    """The points of one task that none is both cheaper and more accurate than, cheapest first.

    Points without an error (a result that was not finite) are on no front. Of points equal in
    both, the first stays.
    """
    best = math.inf
    front = []
    for point in sorted(points, key=lambda p: (p.cost, math.inf if p.error is None else p.error)):
        if point.error is not None and point.error < best:
            front.append(point)
            best = point.error
    return front


def by_task(points: Sequence[Point]) -> dict[tuple[str, str], list[Point]]:
    """Points that compete, by front and task, in their own order."""
    groups: dict[tuple[str, str], list[Point]] = {}
    for point in points:
        groups.setdefault((point.front, point.task), []).append(point)
    return groups


def hypervolume(front: Sequence[Point], cost: float, error: float) -> float:
    """Area that a front dominates below a corner, in decades of cost times decades of error.

    Args:
        front: from :func:`pareto`.
        cost, error: the corner; points beyond it count nothing.
    """
    area, floor = 0.0, error * 10**-DECADES
    kept = [p for p in front if p.cost < cost and p.error is not None and p.error < error]
    ends = [p.cost for p in kept[1:]] + [cost]
    for point, end in zip(kept, ends, strict=True):
        assert point.error is not None
        area += math.log10(end / point.cost) * math.log10(error / max(point.error, floor))
    return area
