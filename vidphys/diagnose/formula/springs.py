"""A smooth law of one coordinate: x'' = f(x) + g(v), f a spline, found from noisy places alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb

import numpy as np
from scipy.interpolate import make_smoothing_spline

from vidphys.diagnose.formula.shooting import Fit, Law, Pieces, cut, fit_law, fit_stages

KNOTS = 16
PIECE = 0.6  # swings in a piece, about
LEAST, MOST = 10, 60  # frames of a piece
ENDS = 0.03  # share of the frames at each end whose speeds are not believed
SMOOTH = 1e-4  # of the places' noise that the spline's bends may cost

TIES = (1.0, 0.03)  # of the noise, that a piece may start from where the one before it ends
FASTER = 1.5  # times the usual swing, that the fastest is
ROUND = 1e-2  # of the accelerations, that bends count at first
WORSE = 1.1  # noise by which longer pieces may seem noisier
DIFFERENCE = 3  # order, that noise is read from
LEFT = 1.5  # times the noise about a smoothing spline, that a law may leave
SIMPLE = ("", "v", "v |v|", "sgn(v)")

SPEEDS: dict[str, tuple] = {
    "": (),
    "v": (lambda v: v,),
    "v |v|": (lambda v: v * np.abs(v),),
    "sgn(v)": (np.sign,),
    "v^3": (lambda v: v**3,),
    "v + v |v|": (lambda v: v, lambda v: v * np.abs(v)),
    "v + sgn(v)": (lambda v: v, np.sign),
    "v + v^3": (lambda v: v, lambda v: v**3),
}


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

    def law(self, speeds: tuple) -> Law:
        """Acceleration; the last numbers are of the terms of the speed."""

        def accelerate(x: np.ndarray, v: np.ndarray, numbers: np.ndarray) -> np.ndarray:
            first, four = self.weights(np.nan_to_num(x))
            columns = np.broadcast_to(np.arange(numbers.shape[1]), x.shape)
            total = sum(four[k] * numbers[first + k, columns] for k in range(4))
            for k, of in enumerate(speeds):
                total = total + numbers[self.count + k] * of(v)
            return total

        return accelerate


@dataclass(frozen=True)
class Spring:
    """A smooth law that was found.

    Args:
        basis: of its force.
        speeds: name of its terms of the speed, a key of ``SPEEDS``.
        fit: of all its numbers: the splines' first.
        pieces: of the recording.
        sigma: noise of the places.
        ties: of the pieces to each other, one after the other; see :func:`fit_law`.
    """

    basis: Basis
    speeds: str
    fit: Fit
    pieces: Pieces
    sigma: float
    ties: tuple[tuple[float, float], ...]

    @property
    def score(self) -> float:
        """Misfit and a price for friction, in nats; less is better."""
        count = int(self.pieces.seen.sum())
        numbers = len(SPEEDS[self.speeds])
        return count / 2 * np.log(self.fit.squares) + numbers * (1 + np.log(count) / 2)

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


def smoothed(x: np.ndarray, times: np.ndarray) -> Smoothed:
    """Smooth clips ``(clips, frames)`` by cross-validation."""
    parts, paths = [], []
    for path, t in zip(x, times, strict=True):
        seen = np.isfinite(path)
        spline = make_smoothing_spline(t[seen], path[seen])
        skip = max(2, int(ENDS * seen.sum()))
        inner = t[seen][skip:-skip]
        parts.append(np.stack([spline(inner), spline(inner, 1), spline(inner, 2)]))
        paths.append(spline)
    places, speeds, accelerations = np.concatenate(parts, 1)
    return Smoothed(places, speeds, accelerations, tuple(paths))


def find_spring(x: np.ndarray, times: np.ndarray) -> Spring | None:
    """The smooth law of a coordinate, with the terms of speed that the evidence asks for.

    Args:
        x: places ``(clips, frames)``, NaN where not seen.
        times: seconds ``(clips, frames)``.

    Returns:
        The law; ``None`` where none rolls along the whole recording to within its noise.
    """
    near = smoothed(x, times)
    low, high = float(np.nanmin(x)), float(np.nanmax(x))
    basis = Basis(low, high)
    fastest = float(np.sqrt(np.mean(near.a**2) / np.mean((near.x - near.x.mean()) ** 2)))
    step = float(np.median(np.diff(times)))
    length = int(np.clip(PIECE * 2 * np.pi / fastest / step, LEAST, MOST))
    pieces = cut(x, times, min(length, x.shape[1]), FASTER * fastest)
    starts = _starts(pieces, near, times)
    springs = [_loose(basis, name, near, pieces, starts, SMOOTH * step**2) for name in SIMPLE]
    found = [spring for spring in springs if spring is not None]
    if not found:
        return None
    found = sorted(found, key=lambda each: each.score)
    finer = cut(x, times, min(length, x.shape[1]), max(_steepest(found[0]), FASTER * fastest))
    own = _own_noise(x, times, near)
    long = [tied(replace(each, pieces=finer), fastest, SMOOTH * step**2) for each in found]
    good = [each for each in long if each.ties and each.sigma < LEFT * own]
    return min(good, key=lambda each: each.score) if good else None


def _own_noise(x: np.ndarray, times: np.ndarray, near: Smoothed) -> float:
    """Noise of the places: about the smoothing splines, or by differences, whichever is less."""
    off = [path - spline(t) for path, t, spline in zip(x, times, near.paths, strict=True)]
    differences = np.diff(x, DIFFERENCE, axis=1) / np.sqrt(comb(2 * DIFFERENCE, DIFFERENCE))
    return float(min(np.nanstd(np.concatenate(off)), np.sqrt(np.nanmean(differences**2))))


def _steepest(spring: Spring) -> float:
    """Angular frequency where the force is steepest, per second."""
    places = np.linspace(spring.basis.low, spring.basis.high, 2 * spring.basis.count)
    force = spring.basis.matrix(places) @ spring.fit.numbers[: spring.basis.count]
    return float(np.sqrt(np.abs(np.diff(force) / np.diff(places)).max()))


def tied(spring: Spring, fastest: float, ridge: float) -> Spring:
    """The same law as one long roll; where none goes along, the pieces stay apart."""
    bends = ridge * _bends(spring.basis, len(spring.fit.numbers))
    law = spring.basis.law(SPEEDS[spring.speeds])
    ties = tuple((close, close * fastest) for close in TIES)
    fit = fit_stages(law, spring.fit.numbers, spring.fit.starts, spring.pieces, ties, bends)
    clips = int((~spring.pieces.follows).sum())
    sigma = np.inf if fit is None else _noise(fit, spring.pieces, clips)
    if fit is None or sigma > WORSE * spring.sigma:
        return spring
    return Spring(spring.basis, spring.speeds, fit, spring.pieces, sigma, ties)


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
    speeds = SPEEDS[name]
    columns = np.concatenate([basis.matrix(near.x), *(of(near.v)[:, None] for of in speeds)], 1)
    bends = _bends(basis, columns.shape[1])
    rows = np.concatenate([columns, ROUND * np.sqrt(len(near.x)) * bends])
    numbers = np.linalg.lstsq(rows, np.append(near.a, np.zeros(len(bends))), rcond=None)[0]
    fit = fit_law(basis.law(speeds), numbers, starts, pieces, None, ridge * bends)
    if fit is None:
        return None
    return Spring(basis, name, fit, pieces, _noise(fit, pieces, len(pieces.x)), ())


def _starts(pieces: Pieces, near: Smoothed, times: np.ndarray) -> np.ndarray:
    """Place and speed at the first frame of each piece, by the smoothing splines."""
    out = []
    for first in pieces.times[:, 0]:
        path = near.paths[int((times == first).any(1).argmax())]
        out.append([path(first), path(first, 1)])
    return np.array(out, float)
