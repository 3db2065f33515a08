"""Impacts: frames between which a speed changes at once, found before any law is fitted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

SIDES = (3, 4, 6, 9, 14, 20, 30, 45)  # frames on each side of a kink
CHANCE = 1e-3  # that noise lets two parabolas with a kink leave so much less than one cubic, of all
SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of a frame interval, at which a kink is tried
GAP = 3.0  # usual frame intervals, over each of a side's, from which frames are not in a row
RIDGE = 1e-12
TURN = 0.1  # of the path's length, that a turn must stand out by
WITHIN = 0.6  # of the frames between turns: longer sides take a turn for a kink
LONGER = 2.0  # times as many, where fewer tell of none and these tell of one wall more than once
HARD = 0.35  # of the usual speed, that an impact changes it by
SURE = 5.0  # standard errors of the change
ALIKE = 0.9  # cosine between the directions of two impacts on one wall
FLAT = 0.25  # of the path's extent along the normal, within which one wall's impacts lie


@dataclass(frozen=True)
class Impact:
    """A speed that changes at once.

    Args:
        frame: the last before it, of those in which the body was seen.
        side: frames on each side that tell of it.
        place: where, ``(k,)``.
        before, after: velocities, ``(k,)``.
    """

    frame: int
    side: int
    place: np.ndarray
    before: np.ndarray
    after: np.ndarray

    @property
    def change(self) -> np.ndarray:
        """Of the velocity, ``(k,)``."""
        return self.after - self.before


def find_impacts(times: np.ndarray, s: np.ndarray) -> list[Impact]:
    """Impacts of one body, by time: what the fewest frames tell that tell of any.

    Each bounce counts as a turn, too, so longer sides tell where the noise hides what shorter ones
    tell; but only of a wall that is struck more than once.

    Args:
        times: of the frames that show it, seconds.
        s: coordinates ``(t, k)``.
    """
    speed, found = _usual(times, s), list[Impact]()
    limit = max(WITHIN * between_turns(s), SIDES[0])
    for side in SIDES:
        if len(times) < 2 * side + 2 or side > (limit if found else LONGER * limit):
            break
        told = bool(found)
        found += _beside(kinks_of(times, s, side), speed, found)
        if side > limit and all(wall.count < 2 for wall in walls_of(found, s)):
            found = []
        if told:  # longer sides take a turn for a kink
            break
    return sorted(found, key=lambda x: x.frame)


def _beside(kinks: Kinks, speed: float, known: list[Impact]) -> list[Impact]:
    """Impacts of windows of one length, the clearest first, that are none of those known."""
    found = list[Impact]()
    strong = kinks.hard * np.log1p(kinks.gain)
    for k in sorted(np.flatnonzero(kinks.clear(speed)), key=lambda k: -strong[k]):
        impact = kinks.impact(int(k))
        if all(abs(impact.frame - x.frame) > kinks.side for x in known + found):
            found.append(impact)
    return found


def impact_between(times: np.ndarray, s: np.ndarray, first: int, last: int) -> int | None:
    """The last frame before the clearest impact of those after ``first`` and up to ``last``.

    Where an impact is looked for, sides of any length may tell of it.

    Args:
        times, s: see `find_impacts`.
    """
    speed, best, found = _usual(times, s), 0.0, None
    for side in SIDES:
        if len(times) < 2 * side + 2:
            break
        kinks = kinks_of(times, s, side)
        frames = np.arange(len(kinks.gain)) + side - 1
        gain = np.where(kinks.clear(speed) & (first < frames) & (frames <= last), kinks.gain, 0.0)
        if gain.max() > best:
            best, found = float(gain.max()), int(frames[gain.argmax()])
    return found


def _usual(times: np.ndarray, s: np.ndarray) -> float:
    """Root mean square speed."""
    return float(np.sqrt(((np.diff(s, axis=0) / np.diff(times)[:, None]) ** 2).sum(-1).mean()))


def seen_as(impacts: list[Impact], times: np.ndarray, s: np.ndarray) -> list[Impact]:
    """The same impacts in other coordinates ``(t, k)``."""
    kinks = {side: kinks_of(times, s, side) for side in {x.side for x in impacts}}
    return [kinks[x.side].impact(x.frame - x.side + 1) for x in impacts]


@dataclass(frozen=True)
class Kinks:
    """Of each window of ``2 side`` frames: the best kink in its middle."""

    side: int
    gain: np.ndarray  # how much less than a cubic it leaves, over chance; 0 if more than a quartic
    sigma: np.ndarray  # of a coordinate, that it leaves
    error: np.ndarray  # of a change of speed
    numbers: np.ndarray  # place, velocity before, half the acceleration, change; (w, 4, k)

    @property
    def change(self) -> np.ndarray:
        return self.numbers[:, 3]

    @cached_property
    def hard(self) -> np.ndarray:
        """By how much the speed changes, ``(w,)``."""
        return np.linalg.norm(self.change, axis=1)

    def clear(self, speed: float) -> np.ndarray:
        """Which of them are impacts of a body of a usual speed, ``(w,)``."""
        return (self.gain > 1) & (self.hard > HARD * speed) & (self.hard > SURE * self.error)

    def impact(self, window: int) -> Impact:
        place, before, _, change = self.numbers[window]
        return Impact(window + self.side - 1, self.side, place, before, before + change)


def kinks_of(times: np.ndarray, s: np.ndarray, side: int) -> Kinks:
    """The best kink between the middle frames of each window of coordinates ``(t, k)``."""
    windows = np.lib.stride_tricks.sliding_window_view
    t = windows(times, 2 * side)
    x = windows(s, 2 * side, axis=0).transpose(0, 2, 1)
    # An impact lasts for a few frames where they follow fast; those do not count.
    away = np.abs(np.arange(2 * side) - (side - 0.5)) > side // 5
    t, x, last, next_ = t[:, away], x[:, away], t[:, side - 1], t[:, side]
    scale = (t[:, -1] - t[:, 0]) / 2
    u = (t - last[:, None]) / scale[:, None]
    cubic, quartic = (_left(np.stack([u**k for k in range(n)], -1), x)[0] for n in (4, 5))
    left, numbers = np.full(len(t), np.inf), np.zeros((len(t), 4, s.shape[1]))
    for share in SHARES:
        kink = last + share * (next_ - last)
        u = (t - kink[:, None]) / scale[:, None]
        design = np.stack([np.ones_like(u), u, u**2, np.maximum(u, 0)], -1)
        tried, found = _left(design, x)
        better = tried < left
        left = np.where(better, tried, left)
        numbers = np.where(better[:, None, None], found, numbers)
    numbers = numbers / scale[:, None, None] ** np.array([0, 1, 2, 1])[:, None]
    freedom = max(x[0].size - numbers[0].size, 1)
    ratio = 1 / special.fdtri(freedom, freedom, CHANCE / len(times))
    sigma = np.sqrt(left / freedom)
    error = sigma / float(np.median(np.diff(times))) / np.sqrt(side)
    gap = 2 * scale > GAP * side * np.median(np.diff(times))
    smooth = quartic < left  # by as many numbers, one of which is the kink's time
    gain = cubic / np.maximum(ratio * left, np.finfo(float).tiny)
    return Kinks(side, np.where(gap | smooth, 0.0, gain), sigma, error, numbers)


def between_turns(s: np.ndarray) -> float:
    """Frames from one turn of a path to the next, in the direction in which it is longest."""
    away = s - s.mean(0)
    along = away @ np.linalg.svd(away, full_matrices=False)[2][0]
    clear = TURN * float(np.ptp(along))
    return len(s) / (_turns(along, clear) + 1)


def _turns(along: np.ndarray, clear: float) -> int:
    """How often a path turns round, and then goes back by more than ``clear``."""
    turns, way, low, high = 0, 0, along[0], along[0]
    for x in along:
        low, high = min(low, x), max(high, x)
        if way >= 0 and high - x > clear:
            turns, way, low = turns + (way > 0 or high - along[0] > clear), -1, x
        elif way <= 0 and x - low > clear:
            turns, way, high = turns + (way < 0 or along[0] - low > clear), 1, x
    return turns


def _left(design: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum of squares that least squares leave in each window ``(w,)``, and the numbers."""
    turned = design.transpose(0, 2, 1)
    ridge = RIDGE * np.eye(design.shape[-1])
    numbers = np.linalg.solve(turned @ design + ridge, turned @ x)
    return ((x - design @ numbers) ** 2).sum((1, 2)), numbers


@dataclass(frozen=True)
class Struck:
    """A wall that several impacts tell of.

    Args:
        normal: towards it, ``(k,)``.
        place: along the normal.
        restitution: speed across it after an impact over that before, the median.
        along: the same of the speed along it.
        count: impacts.
    """

    normal: np.ndarray
    place: float
    restitution: float
    along: float
    count: int


def walls_of(impacts: list[Impact], s: np.ndarray) -> list[Struck]:
    """Walls that impacts share, those struck most often first.

    Args:
        impacts: of one body.
        s: all its coordinates ``(t, k)``.
    """
    left, walls = list(impacts), []
    while left:
        first = max(left, key=lambda x: float(np.linalg.norm(x.change)))
        normal = -first.change / np.linalg.norm(first.change)
        same = [x for x in left if -x.change @ normal > ALIKE * np.linalg.norm(x.change)]
        normal = -np.sum([x.change for x in same], axis=0)
        normal = normal / np.linalg.norm(normal)
        depth, extent = np.array([x.place @ normal for x in same]), np.ptp(s @ normal)
        same = [x for x, d in zip(same, depth, strict=True) if depth.max() - d < FLAT * extent]
        left = [x for x in left if all(x is not y for y in same)]
        walls.append(_struck(same, normal))
    return sorted(walls, key=lambda w: -w.count)


def _struck(impacts: list[Impact], normal: np.ndarray) -> Struck:
    across = [(x.before @ normal, x.after @ normal) for x in impacts]
    lost = [-after / before for before, after in across if before > 0]
    beside = [
        (
            np.linalg.norm(x.after - x.after @ normal * normal),
            np.linalg.norm(x.before - x.before @ normal * normal),
        )
        for x in impacts
    ]
    kept = [after / before for after, before in beside if before > 0]
    return Struck(
        normal,
        float(np.median([x.place @ normal for x in impacts])),
        float(np.clip(np.median(lost), 0.05, 1.0)) if lost else 0.5,
        float(np.clip(np.median(kept), 0.05, 1.0)) if kept and len(normal) > 1 else 1.0,
        len(impacts),
    )
