"""A curve in the plane that a body keeps to, by its length, as all of its places draw it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

DEGREE = 3
KNOTS = (0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36)  # within a curve, of which one count is taken
SEEN = 0.5  # places that each part of a spline is drawn by at least
POINTS = 600  # of a curve, evenly along it
STEPS = 100  # in a curve's extent: places that lie nearer to the last one tell no way
BACK = -0.5  # cosine of the turn from one step to the next, from which a body goes back
AHEAD = 0.1  # of a place along the curve: its weight where the curve meets itself
ROUNDS = 3  # of places along the curve, and the curve through them


@dataclass(frozen=True, eq=False)
class Curve:
    """A plane curve; beyond its ends it goes straight on.

    Args:
        points: evenly along it, ``(n, 2)``, unit of the positions.
        length: from the first to the last, the same unit.
        free: numbers that were fitted to draw it.
    """

    points: np.ndarray
    length: float
    free: int

    @cached_property
    def spacing(self) -> float:
        """From one point to the next."""
        return self.length / (len(self.points) - 1)

    @cached_property
    def along(self) -> np.ndarray:
        """Lengths from the first point to each, ``(n,)``."""
        return np.linspace(0.0, self.length, len(self.points))

    @cached_property
    def tangents(self) -> np.ndarray:
        """Directions of length one, ``(n, 2)``."""
        slope = np.gradient(self.points, axis=0)
        return slope / np.linalg.norm(slope, axis=1, keepdims=True)

    @cached_property
    def bends(self) -> np.ndarray:
        """Curvature, positive to the left, ``(n,)``."""
        return np.gradient(self._headings, self.spacing)

    @cached_property
    def _headings(self) -> np.ndarray:
        """Radians from the first axis, ``(n,)``."""
        x, y = self.tangents.T
        return np.unwrap(np.arctan2(y, x))

    @cached_property
    def sharpest(self) -> float:
        """The largest curvature."""
        return float(np.abs(self.bends).max())

    @cached_property
    def table(self) -> np.ndarray:
        """Tangents and curvature, ``(n, 3)``."""
        return np.column_stack([self.tangents, self.bends])

    def row(self, s: np.ndarray) -> np.ndarray:
        """Of the points, the nearest to lengths ``(t,)``."""
        return np.clip(np.rint(s / self.spacing), 0, len(self.points) - 1).astype(int)

    @property
    def turn(self) -> float:
        """Radians between the directions that differ most."""
        return float(np.ptp(self._headings))

    def at(self, s: np.ndarray) -> np.ndarray:
        """Places ``(…, 2)`` of lengths ``(…)`` from the first point."""
        inside = np.clip(s, 0.0, self.length)
        on = np.stack([np.interp(inside, self.along, x) for x in self.points.T], -1)
        ends = np.where((s > inside)[..., None], self.tangents[-1], self.tangents[0])
        return on + (s - inside)[..., None] * ends

    def read(self, places: np.ndarray) -> np.ndarray:
        """Lengths from the first point ``(t,)`` of places ``(t, 2)`` near the curve, in order.

        Where the curve meets itself a body goes on.
        """
        out = np.empty(len(places))
        for i, place in enumerate(places):
            miss = ((self.points - place) ** 2).sum(1)
            if i > 0:
                step = out[i - 1] - out[i - 2] if i > 1 else 0.0
                miss += (AHEAD * (self.along - out[i - 1] - step)) ** 2
            near = int(miss.argmin())
            out[i] = self.along[near] + (place - self.points[near]) @ self.tangents[near]
        return out


def curve_through(paths: Sequence[np.ndarray]) -> Curve | None:
    """The curve that all places lie on or near; ``None`` where they draw none.

    Args:
        paths: of a body, each in order, ``(t, 2)``.
    """
    longest = max((way for path in paths for way in _ways(path)), key=_length, default=None)
    if longest is None or len(longest) <= DEGREE + 1:
        return None
    curve: Curve | None = _evenly(longest, 0)
    for _ in range(ROUNDS):
        if curve is not None:
            s = np.concatenate([curve.read(path) for path in paths])
            curve = _drawn(s, np.concatenate(list(paths)))
    return curve


def _ways(path: np.ndarray) -> list[np.ndarray]:
    """Parts of a path on which a body does not turn back, without places next to each other."""
    least = float(np.linalg.norm(np.ptp(path, axis=0))) / STEPS
    ways, kept = [], [path[0]]
    for place in path[1:]:
        step = place - kept[-1]
        size = np.linalg.norm(step)
        if size <= least:
            continue
        if len(kept) > 1:
            last = kept[-1] - kept[-2]
            if step @ last < BACK * size * np.linalg.norm(last):
                ways.append(np.array(kept))
                kept = kept[-1:]
        kept.append(place)
    return [*ways, np.array(kept)]


def _length(way: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def _evenly(path: np.ndarray, free: int) -> Curve:
    """The curve straight from place to place."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    even = np.linspace(0.0, along[-1], POINTS)
    points = np.stack([np.interp(even, along, x) for x in path.T], 1)
    return Curve(points, float(along[-1]), free)


def _drawn(s: np.ndarray, places: np.ndarray) -> Curve | None:
    """The spline through places at their lengths, of as many knots as Schwarz's price allows.

    ``None`` where a part even of the plainest is drawn by no place.
    """
    from scipy.interpolate import BSpline  # takes a moment to load, which few recordings need

    best, least = None, np.inf
    for count in KNOTS:
        inner = np.linspace(s.min(), s.max(), count + 2)
        knots = np.concatenate([[inner[0]] * DEGREE, inner, [inner[-1]] * DEGREE])
        free = count + DEGREE + 1
        design = BSpline.design_matrix(np.clip(s, inner[0], inner[-1]), knots, DEGREE).toarray()
        if 2 * free > len(s) or (design.sum(0) < SEEN).any():
            break
        found = np.linalg.lstsq(design, places, rcond=None)[0]
        left = ((places - design @ found) ** 2).sum()
        price = 0.5 * len(s) * np.log(max(left, np.finfo(float).tiny)) + 0.5 * free * np.log(len(s))
        if price < least:
            best, least = (BSpline(knots, found, DEGREE), inner, free), price
    if best is None:
        return None
    spline, inner, free = best
    return _evenly(spline(np.linspace(inner[0], inner[-1], 4 * POINTS)), free)
