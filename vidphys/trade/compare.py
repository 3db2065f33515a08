"""Whether a front has moved back since an older measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vidphys.points.pareto import pareto
from vidphys.points.point import Point

TIME, ERROR = 0.05, 0.02  # shares by which a front may move back
NEGLIGIBLE = 1e-12  # errors below it are rounding and equal


@dataclass(frozen=True)
class Change:
    """A point of the old front, and what the new measurement has in its place.

    Args:
        old: on the old front.
        new: the new point that is the best answer to it; ``None`` where none is.
        slower: new cost over old for at most the old error, less 1.
        worse: new error over old for at most the old cost, less 1; 0 where it is slower only.
    """

    old: Point
    new: Point | None
    slower: float
    worse: float

    @property
    def moved_back(self) -> bool:
        """More than the allowed share in time and, where time is kept, in error."""
        return self.new is None or self.slower > TIME or self.worse > ERROR

    @property
    def sentence(self) -> str:
        """The change in a line."""
        where = f"{self.old.front}, {self.old.task}: {self.old.label}"
        if self.new is None:
            return f"{where}: nothing in its place"
        return f"{where}: {self.slower:+.1%} time, {self.worse:+.1%} error"


def compare(old: Sequence[Point], new: Sequence[Point]) -> list[Change]:
    """How each point of an older front stands against the new points of the same task.

    The same configuration is compared with itself: its time, unless the quartiles of the two
    overlap (that is noise), and its error. One that was not measured again is compared with the
    cheapest new point that is as accurate.

    Args:
        old, new: points of one task, device and number of threads.
    """
    again = {point.key: point for point in new}
    return [_same(p, again[p.key]) if p.key in again else _replaced(p, new) for p in pareto(old)]


def _same(old: Point, new: Point) -> Change:
    assert old.error is not None
    if new.error is None:
        return Change(old, None, 0.0, 0.0)
    apart = new.cost_low > old.cost_high
    slower = new.cost / old.cost - 1 if apart else min(0.0, new.cost / old.cost - 1)
    return Change(old, new, slower, _ratio(new.error, old.error))


def _replaced(old: Point, new: Sequence[Point]) -> Change:
    assert old.error is not None
    as_good = [p for p in new if p.error is not None and p.error <= old.error * (1 + ERROR)]
    if not as_good:
        return Change(old, None, 0.0, 0.0)
    best = min(as_good, key=lambda p: p.cost)
    return Change(old, best, best.cost / old.cost - 1, 0.0)


def _ratio(new: float, old: float) -> float:
    return max(new, NEGLIGIBLE) / max(old, NEGLIGIBLE) - 1
