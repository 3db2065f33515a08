"""How long units of work take side by side, before they are run: a small simulation."""

from __future__ import annotations

import heapq
from collections.abc import Sequence


def makespan(seconds: Sequence[float], workers: int, start: float = 0.0) -> float:
    """Seconds until all units are done, each given in its turn to whoever is free first.

    This is what both engines do. A unit is never shared out, so that the longest one is the least
    that any number of workers can reach.

    Args:
        seconds: of each unit, in the order in which they are given out.
        workers: that work side by side.
        start: seconds until a worker takes its first unit.

    Raises:
        ValueError: no worker.

    Example:
        >>> makespan([3.0, 1.0, 1.0, 2.0], workers=2)
        4.0
        >>> makespan([3.0, 1.0, 1.0, 2.0], workers=64, start=0.5)
        3.5
    """
    if workers < 1:
        raise ValueError(f"makespan: `workers` {workers}: at least one is needed")
    free = [start] * min(workers, max(1, len(seconds)))
    for each in seconds:
        heapq.heappush(free, heapq.heappop(free) + each)
    return max(free) if seconds else 0.0
