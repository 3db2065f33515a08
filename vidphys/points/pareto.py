"""Which measured points no other one of their task beats."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vidphys.points.point import Point


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
