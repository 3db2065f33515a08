"""Choosing a measured point under a bound. Nothing between or beyond points is ever made up."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from vidphys.errors import InputError
from vidphys.points.pareto import by_task
from vidphys.points.point import Point

EXAMPLE = 'such as "inversion_nmse<=0.02" or "ms_per_clip<=20"'


@dataclass(frozen=True)
class Bound:
    """``quantity <= limit``, where the quantity is a cost or an error by name."""

    quantity: str
    limit: float

    @classmethod
    def parse(cls, text: str) -> Bound:
        """From ``"name<=number"``.

        Raises:
            InputError: anything else.
        """
        found = re.fullmatch(r"\s*([a-z][a-z0-9_]*)\s*<=\s*([0-9.eE+-]+)\s*", text)
        try:
            if found is None:
                raise ValueError
            return cls(found[1], float(found[2]))
        except ValueError as error:
            raise InputError(f"`pick` {text!r}: give a bound, {EXAMPLE}") from error

    def value(self, point: Point) -> float | None:
        """The quantity at a point; ``None`` where its result was not finite."""
        return point.cost if self.quantity == point.cost_name else point.error


@dataclass(frozen=True)
class Choice:
    """The point that was chosen for a task, or the one that comes nearest.

    Args:
        bound: what was asked.
        point: measured.
        met: whether the bound holds; otherwise the point is only the nearest measured one.
    """

    bound: Bound
    point: Point
    met: bool

    @property
    def margin(self) -> float:
        """Share of the limit that is left; negative where the bound is not met."""
        value = self.bound.value(self.point)
        assert value is not None
        return (self.bound.limit - value) / abs(self.bound.limit) if self.bound.limit else -value

    @property
    def sentence(self) -> str:
        """What was chosen, in a line."""
        p, value = self.point, self.bound.value(self.point)
        asked = f"{self.bound.quantity} <= {self.bound.limit:g}"
        if not self.met:
            return (
                f"{p.task}: no measured point has {asked}; the nearest has {value:.3g} "
                f"({p.label}); nothing is extrapolated"
            )
        return (
            f"{p.task}: {p.label}: {p.cost_name} {p.cost:.3g} [{p.cost_low:.3g}, "
            f"{p.cost_high:.3g}], {p.error_name} {p.error:.3g}; {asked} with {self.margin:.0%} "
            "to spare"
        )


def pick(points: Sequence[Point], bound: Bound) -> list[Choice]:
    """For each task that has the quantity: the cheapest point within an error, or the most
    accurate one within a cost; the nearest where none is within.

    A cost counts by its upper quartile: a point is within a cost if three of four calls are.

    Args:
        points: measured, of any fronts.
        bound: on the cost or the error of one of them.

    Raises:
        InputError: no point has the quantity, or none has a finite result.

    Example:
        >>> rest = dict(cost_low=1.0, cost_high=1.0, clock='cpu', wall=1.0, repeats=3,
        ...             warmup_seconds=0.0, peak_bytes=None, error_name='error', seed=0,
        ...             reference='float64', device='cpu', dtype='float32', threads=1)
        >>> fine = Point('rollouts', 'gravity', {'dt': 0.002}, 'ms', 8.0, error=1e-4, **rest)
        >>> coarse = Point('rollouts', 'gravity', {'dt': 0.01}, 'ms', 2.0, error=1e-2, **rest)
        >>> [choice.point.label for choice in pick([fine, coarse], Bound.parse('error<=0.02'))]
        ['dt 0.01']
    """
    names = sorted({name for p in points for name in (p.cost_name, p.error_name)})
    if bound.quantity not in names:
        raise InputError(
            f"`pick` {bound.quantity}: not measured here; there are {', '.join(names) or 'none'}"
        )
    usable = [
        p for p in points if bound.quantity in (p.cost_name, p.error_name) and p.error is not None
    ]
    if not usable:
        raise InputError(f"`pick` {bound.quantity}: no measured point has a finite result")
    return [_choose(group, bound) for group in by_task(usable).values()]


def _choose(points: Sequence[Point], bound: Bound) -> Choice:
    on_cost = bound.quantity == points[0].cost_name
    within = [p for p in points if (p.cost_high if on_cost else _error(p)) <= bound.limit]
    if within:
        best = min(within, key=lambda p: (_error(p), p.cost) if on_cost else (p.cost, _error(p)))
        return Choice(bound, best, True)
    nearest = min(
        points, key=lambda p: (p.cost_high, _error(p)) if on_cost else (_error(p), p.cost)
    )
    return Choice(bound, nearest, False)


def _error(point: Point) -> float:
    assert point.error is not None
    return point.error
