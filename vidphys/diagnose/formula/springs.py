"""A smooth law of one coordinate: x'' = f(x) + g(v), f a spline, found from noisy places alone.

Where there is none, g may change with the place, as in van der Pol's oscillator.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import comb
from typing import TYPE_CHECKING

import numpy as np

from vidphys.diagnose.formula.shooting import Fit, Law, Pieces, cut, fit_law, fit_stages

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

KNOTS = 24
PIECE = 0.6  # swings in a piece, about
LEAST, MOST = 10, 60  # frames of a piece
ENDS = 0.03  # share of the frames at each end whose speeds are not believed
SMOOTH = 1e-4  # of the places' noise that the spline's bends may cost

TIES = (1.0, 0.03)  # of the noise, that a piece may start from where the last ends, before none may
FASTER = 1.5  # times the usual swing, that the fastest is
ROUND = 1e-2  # of the accelerations, that bends count at first
WORSE = 1.1  # noise by which longer pieces may seem noisier
ORDERS = range(2, 8)  # of the differences that noise is read from
SHARES = (0.95, 0.6)  # of the noise, that smoothing takes away
SOFTEST, STIFFEST, BISECTIONS = 1e-4, 1e10, 10  # of smoothing, frames cubed
LEFT = 1.5  # times the noise about a smoothing spline, that a law may leave
SIMPLE = ("", "v", "v |v|", "sgn(v)")

WORDS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "v": lambda x, v: v,
    "v |v|": lambda x, v: v * np.abs(v),
    "sgn(v)": lambda x, v: np.sign(v),
    "v^3": lambda x, v: v**3,
    "x v": lambda x, v: x * v,
    "x^2 v": lambda x, v: x**2 * v,
}
EVERYWHERE: dict[str, tuple[str, ...]] = {
    "": (),
    **{word: (word,) for word in SIMPLE[1:]},
    "v^3": ("v^3",),
    **{f"v + {word}": ("v", word) for word in (*SIMPLE[2:], "v^3")},
}
PLACEWISE = "v + x v + x^2 v"  # friction that changes with the place
BY_PLACE = {"v + x^2 v": ("v", "x^2 v"), PLACEWISE: ("v", "x v", "x^2 v")}
SPEEDS = EVERYWHERE | BY_PLACE
FAMILIES = (SIMPLE, (PLACEWISE,))  # what changes with the place is asked where nothing else holds


@dataclass(frozen=True)
class Basis:
    """Uniform cubic B-splines between two places, straight on beyond them.

    Args:
        low, high: the places.
        count: of splines.
    """

    low: float
    high: float
    count: int = KNOTS

    def weights(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First spline, and the values of the four, at places: ``(...)`` and ``(4, ...)``."""
        at = (np.clip(x, self.low, self.high) - self.low) / self.width
        first = np.clip(at.astype(int), 0, self.count - 4)
        u = at - first
        four = ((1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3)
        return first, np.stack(four) / 6

    @property
    def ends(self) -> tuple[float, float]:
        """The two places."""
        return self.low, self.high

    @property
    def width(self) -> float:
        """Of an interval between knots."""
        return (self.high - self.low) / (self.count - 3)

    def matrix(self, x: np.ndarray) -> np.ndarray:
        """Values of all splines at places, ``(m, count)``."""
        first, four = self.weights(x)
        out = np.zeros((len(x), self.count))
        for k in range(4):
            out[np.arange(len(x)), first + k] += four[k]
        return out

    def law(self, speeds: str) -> Law:
        """Acceleration, with words of the speed by a name of ``SPEEDS``."""

        def columns(numbers: np.ndarray, x: np.ndarray) -> np.ndarray:
            splines = self.matrix(x)
            return np.concatenate([(splines @ numbers)[:, None], splines], 1)

        return Law(columns, SPEEDS[speeds], self.low, self.high)


@dataclass(frozen=True)
class Spring:
    """A smooth law that was found.

    Args:
        basis: of its force.
        speeds: name of its terms of the speed, a key of ``SPEEDS``.
        fit: of all its numbers: the splines' first.
        pieces: of the recording.
        sigma: noise of the places.
        whole: whether each clip is one roll.
    """

    basis: Basis
    speeds: str
    fit: Fit
    pieces: Pieces
    sigma: float
    whole: bool = False

    @property
    def score(self) -> float:
        """Misfit and a price for friction, in nats; less is better."""
        numbers = len(SPEEDS[self.speeds])
        return self.count / 2 * np.log(self.fit.squares) + numbers * (1 + np.log(self.count) / 2)

    @property
    def count(self) -> int:
        """Frames that were fitted."""
        return int(self.pieces.seen.sum())

    @property
    def covariance(self) -> np.ndarray:
        """Of all numbers."""
        return self.sigma**2 * self.fit.inverse


@dataclass(frozen=True)
class Smoothed:
    """Places, speeds and accelerations of a smoothing spline, flat, where they are believed."""

    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    paths: tuple


def smoothed(x: np.ndarray, times: np.ndarray, share: float) -> Smoothed:
    """Smooth clips ``(clips, frames)`` so that a share of the places' noise is left."""
    parts, paths = [], []
    for path, t in zip(x, times, strict=True):
        seen = np.isfinite(path)
        spline = _through(t[seen], path[seen], share * noise_of(path[None]))
        skip = max(2, int(ENDS * seen.sum()))
        inner = t[seen][skip:-skip]
        parts.append(np.stack([spline(inner), spline(inner, 1), spline(inner, 2)]))
        paths.append(spline)
    places, speeds, accelerations = np.concatenate(parts, 1)
    return Smoothed(places, speeds, accelerations, tuple(paths))


def _through(t: np.ndarray, x: np.ndarray, far: float) -> BSpline:
    """The smoothest spline no farther than that from the places, root mean square."""
    from scipy.interpolate import (
        make_smoothing_spline,  # a tenth of a second to load, and seldom asked
    )

    step = float(np.median(np.diff(t)))
    low, high = np.log(SOFTEST) + 3 * np.log(step), np.log(STIFFEST) + 3 * np.log(step)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        spline = make_smoothing_spline(t, x, lam=float(np.exp(middle)))
        if np.std(x - spline(t)) > far:
            high = middle
        else:
            low = middle
    return spline


def noise_of(x: np.ndarray) -> float:
    """Noise of places ``(clips, frames)``, by the differences that tell the least of it."""
    return min(
        float(np.sqrt(np.nanmean(np.diff(x, order, axis=1) ** 2) / comb(2 * order, order)))
        for order in ORDERS
    )


def find_spring(
    x: np.ndarray, times: np.ndarray, families: Sequence[Sequence[str]] = FAMILIES
) -> Spring | None:
    """The smooth law of a coordinate, with the terms of speed that the evidence asks for.

    Args:
        x: places ``(clips, frames)``, NaN where not seen.
        times: seconds ``(clips, frames)``.
        families: names of terms of the speed, keys of ``SPEEDS``; the first family of which one
            holds is the one that is told.

    Returns:
        The law; ``None`` where none rolls along the whole recording to within its noise.
    """
    near = [smoothed(x, times, share) for share in SHARES]
    return next(filter(None, (_found(x, times, near, names) for names in families)), None)


def _found(
    x: np.ndarray, times: np.ndarray, near: Sequence[Smoothed], names: Sequence[str]
) -> Spring | None:
    """The same with one of some terms of the speed, from places smoothed more and less."""
    basis = Basis(float(np.nanmin(x)), float(np.nanmax(x)))
    ridge = SMOOTH * float(np.median(np.diff(times))) ** 2
    tries = [_apart(basis, x, times, one, ridge, names) for one in near]
    fastest, found = min(tries, key=lambda one: min((s.sigma for s in one[1]), default=np.inf))
    if not found:
        return None
    best = min(found, key=lambda each: each.score)
    finer = best.pieces.stepped(max(_steepest(best), FASTER * fastest))
    long = [one_roll(replace(each, pieces=finer), fastest, ridge) for each in found]
    own = noise_of(x)
    good = [each for each in long if each is not None and each.sigma < LEFT * own]
    return min(good, key=lambda each: each.score) if good else None


def _apart(
    basis: Basis,
    x: np.ndarray,
    times: np.ndarray,
    near: Smoothed,
    ridge: float,
    names: Sequence[str],
) -> tuple[float, list[Spring]]:
    """Springs with some frictions, their pieces apart; and the usual swing, radians per second."""
    fastest = float(np.sqrt(np.mean(near.a**2) / np.mean((near.x - near.x.mean()) ** 2)))
    step = float(np.median(np.diff(times)))
    length = int(np.clip(PIECE * 2 * np.pi / fastest / step, LEAST, MOST))
    pieces = cut(x, times, min(length, x.shape[1]), FASTER * fastest)
    starts = _starts(pieces, near, times)
    springs = (_loose(basis, name, near, pieces, starts, ridge) for name in names)
    return fastest, [spring for spring in springs if spring is not None]


def _steepest(spring: Spring) -> float:
    """Angular frequency where the force is steepest, per second."""
    places = np.linspace(spring.basis.low, spring.basis.high, 2 * spring.basis.count)
    force = spring.basis.matrix(places) @ spring.fit.numbers[: spring.basis.count]
    return float(np.sqrt(np.abs(np.diff(force) / np.diff(places)).max()))


def one_roll(spring: Spring, fastest: float, ridge: float) -> Spring | None:
    """The same law as one roll of each clip; ``None`` where none goes along."""
    bends = ridge * _bends(spring.basis, len(spring.fit.numbers))
    law = spring.basis.law(spring.speeds)
    ties = tuple((close, close * fastest) for close in TIES)
    fit = fit_stages(law, spring.fit.numbers, spring.fit.starts, spring.pieces, ties, bends)
    if fit is None:
        return None
    begun, pieces = fit.starts[~spring.pieces.follows], spring.pieces.joined()
    fit = fit_law(law, fit.numbers, begun, pieces, None, bends)
    if fit is None or (sigma := _noise(fit, pieces, len(begun))) > WORSE * spring.sigma:
        return None
    return Spring(spring.basis, spring.speeds, fit, pieces, sigma, True)


def _bends(basis: Basis, numbers: int) -> np.ndarray:
    """Second differences of the splines' numbers, ``(count - 2, numbers)``."""
    out = np.zeros((basis.count - 2, numbers))
    out[:, : basis.count] = np.diff(np.eye(basis.count), 2, axis=0)
    return out


def _noise(fit: Fit, pieces: Pieces, starts: int) -> float:
    """Of the places, by what a fit with so many free starts leaves."""
    free = int(pieces.seen.sum()) - len(fit.numbers) - 2 * starts
    return float(np.sqrt(fit.squares / max(free, 1)))


def _loose(
    basis: Basis, name: str, near: Smoothed, pieces: Pieces, starts: np.ndarray, ridge: float
) -> Spring | None:
    """A spring with these terms of the speed, its pieces apart."""
    speeds = [WORDS[word](near.x, near.v)[:, None] for word in SPEEDS[name]]
    columns = np.concatenate([basis.matrix(near.x), *speeds], 1)
    bends = _bends(basis, columns.shape[1])
    rows = np.concatenate([columns, ROUND * np.sqrt(len(near.x)) * bends])
    numbers = np.linalg.lstsq(rows, np.append(near.a, np.zeros(len(bends))), rcond=None)[0]
    fit = fit_law(basis.law(name), numbers, starts, pieces, None, ridge * bends)
    if fit is None:
        return None
    return Spring(basis, name, fit, pieces, _noise(fit, pieces, len(pieces.x)))


def _starts(pieces: Pieces, near: Smoothed, times: np.ndarray) -> np.ndarray:
    """Place and speed at the first frame of each piece, by the smoothing splines."""
    out = []
    for first in pieces.times[:, 0]:
        path = near.paths[int((times == first).any(1).argmax())]
        out.append([path(first), path(first, 1)])
    return np.array(out, float)
