"""What turns in its place, as a fan's blades do: it is no body that goes anywhere.

Blades look alike, so who follows one often goes on with the next; but all stay on one circle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from binders.hypotheses import Hypothesis

SEEN = 0.5  # of the frames, in which a blade is seen
BLADES = 3  # at least: two may be bodies on a rod
OFF = 0.2  # of its radius, by which few places of a blade are off the circle; and how few these are
AT_ONE = 0.3  # of the radius, within which the middles of their circles are
AS_FAR = 1.3  # times, by which their radii may differ
STAYS = 0.7  # of its frames, in which a thing is within such a circle: a piece of the wheel
SECTORS, ROUND = 12, 9  # of a circle, and how many of them it goes through
ROUNDS = 3


@dataclass(frozen=True)
class _Circle:
    middle: np.ndarray
    radius: float


def wheels(bodies: Sequence[Hypothesis]) -> set[int]:
    """Which of the things that were followed are blades, or go round with them."""
    circles = [circle for body in bodies if (circle := _circle(body)) is not None]
    for blade in circles:
        if sum(_alike(circle, blade) for circle in circles) >= BLADES:
            return {k for k, body in enumerate(bodies) if _stays(body, blade)}
    return set()


def _alike(one: _Circle, other: _Circle) -> bool:
    apart = np.linalg.norm(one.middle - other.middle)
    larger = max(one.radius / other.radius, other.radius / one.radius)
    return bool(apart < AT_ONE * other.radius and larger < AS_FAR)


def _stays(body: Hypothesis, blade: _Circle) -> bool:
    """Whether it goes round within the blades' circle; or on it, also where an edge cuts that."""
    away = body.positions[body.seen] - blade.middle
    far = np.linalg.norm(away, axis=1)
    within = far < AS_FAR * blade.radius
    on_it = np.percentile(np.abs(far - blade.radius), 100 * (1 - OFF)) < OFF * blade.radius
    return bool(within.mean() > STAYS and (on_it or _through(away) >= ROUND))


def _through(away: np.ndarray) -> int:
    """How many sectors about a middle places ``(t, 2)`` from it lie in."""
    turned = np.arctan2(away[:, 1], away[:, 0]) % (2 * np.pi)
    return len(set((turned / (2 * np.pi) * SECTORS).astype(int)))


def _circle(body: Hypothesis) -> _Circle | None:
    """The circle on which most of its places are, if it goes round there; by least squares."""
    if body.seen.mean() < SEEN:
        return None
    places = body.positions[body.seen]
    on_it = np.arange(len(places))
    for _ in range(ROUNDS):
        some = places[on_it]
        design = np.column_stack([2 * some, np.ones(len(some))])
        (x, y, rest), *_ = np.linalg.lstsq(design, (some**2).sum(1), rcond=None)
        middle, radius = np.array([x, y]), float(np.sqrt(max(rest + x * x + y * y, 0.0)))
        away = places - middle
        off = np.abs(np.linalg.norm(away, axis=1) - radius)
        on_it = np.argsort(off)[: int((1 - OFF) * len(places))]
    round_ = off[on_it].max() < OFF * radius and _through(away) >= ROUND
    return _Circle(middle, radius) if round_ else None
