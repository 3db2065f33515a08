"""Laws of one coordinate fitted to where it was seen: rolled from piece to piece, all at once.

A recording is cut into pieces, each with a start of its own; the law's numbers are common. Pieces
and nudged numbers are rolled together, as one array, by Runge and Kutta's fourth order, to the
frames' own times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Law = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # (x, v, numbers (n, q)) -> a
STEPS, TRIES = 12, 4
FAR = 1e3  # times the spread of the places, beyond which a roll has gone astray
FINEST = 4  # steps in a frame interval, at most
TURN = 0.3  # radians of the fastest swing in a step
ENOUGH = 1e-5  # of the squares, by which a step must lower them


@dataclass(frozen=True)
class Pieces:
    """Pieces of a recording of one coordinate, each to the first frame of the next.

    Args:
        x: places, ``(pieces, frames)``, NaN where not seen or where the next piece has them.
        times: seconds, ``(pieces, frames)``.
        follows: whether a piece goes on where the one before it ends, ``(pieces,)``.
        substeps: of a frame interval.
    """

    x: np.ndarray
    times: np.ndarray
    follows: np.ndarray
    substeps: int

    @property
    def seen(self) -> np.ndarray:
        """Where a place was seen."""
        return np.isfinite(self.x)


@dataclass(frozen=True)
class Fit:
    """A law fitted to pieces.

    Args:
        numbers: of the law, ``(n,)``.
        starts: place and speed of each piece's first frame, ``(pieces, 2)``.
        squares: sum of squared misfits, in the unit of the places.
        inverse: of the normal matrix of the numbers, starts solved for, ``(n, n)``; times the
            noise's variance it is their covariance.
    """

    numbers: np.ndarray
    starts: np.ndarray
    squares: float
    inverse: np.ndarray


def cut(x: np.ndarray, times: np.ndarray, length: int, fastest: float) -> Pieces:
    """Cut a recording into pieces, one after the other.

    Args:
        x: places ``(clips, frames)``, NaN where not seen.
        times: seconds ``(clips, frames)``.
        length: frames of a piece; the last of a clip may have fewer.
        fastest: angular frequency of the fastest swing, per second.
    """
    frames = x.shape[1]
    count = max(1, round(frames / length))
    length = -(-frames // count)
    pieces, seconds, follows = [], [], []
    for path, t in zip(x, times, strict=True):
        after = t[-1] + np.median(np.diff(t)) * np.arange(1, length + 2)
        padded, stamps = np.append(path, np.full(length + 1, np.nan)), np.append(t, after)
        for first in range(0, frames, length):
            piece = padded[first : first + length + 1].copy()
            piece[-1] = np.nan
            pieces.append(piece)
            seconds.append(stamps[first : first + length + 1])
            follows.append(first > 0)
    widest = float(np.max(np.diff(np.stack(seconds), axis=1)))
    substeps = int(np.clip(np.ceil(widest * fastest / TURN), 1, FINEST))
    return Pieces(np.stack(pieces), np.stack(seconds), np.array(follows), substeps)


def roll(law: Law, numbers: np.ndarray, starts: np.ndarray, pieces: Pieces) -> np.ndarray:
    """Places at all frames, and at last the speed.

    Args:
        law: acceleration.
        numbers: ``(n, q)``, one column for each roll.
        starts: ``(2, pieces, q)``.
        pieces: give the times.

    Returns:
        ``(frames + 1, pieces, q)``.
    """
    x, v = starts
    frames = pieces.x.shape[1]
    out = np.empty((frames + 1, *x.shape))
    out[0] = x
    with np.errstate(all="ignore"):
        for frame in range(1, frames):
            gap = (pieces.times[:, frame] - pieces.times[:, frame - 1])[:, None]
            h = gap / pieces.substeps
            for _ in range(pieces.substeps):
                a1 = law(x, v, numbers)
                v2 = v + 0.5 * h * a1
                a2 = law(x + 0.5 * h * v, v2, numbers)
                v3 = v + 0.5 * h * a2
                a3 = law(x + 0.5 * h * v2, v3, numbers)
                v4 = v + h * a3
                a4 = law(x + h * v3, v4, numbers)
                x = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
                v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            out[frame] = x
    out[-1] = v
    return out


def fit_law(
    law: Law,
    numbers: np.ndarray,
    starts: np.ndarray,
    pieces: Pieces,
    tie: tuple[float, float] | None = None,
    ridge: np.ndarray | None = None,
) -> Fit | None:
    """Fit a law's numbers and the pieces' starts by damped Gauss-Newton steps.

    Args:
        law: acceleration.
        numbers: at first, ``(n,)``.
        starts: at first, ``(pieces, 2)``.
        pieces: what is fitted to.
        tie: how far in place and in speed a piece may start from where the one before it ends, as
            standard deviations in units of the noise's; ``None`` lets it start anywhere. The pieces
            are one long roll where both are small.
        ridge: ``(k, n)``, rows whose products with the numbers are held small, in the unit of the
            places.

    Returns:
        The fit; ``None`` where no roll stays near what was seen.
    """
    problem = _Problem(law, pieces, tie, np.zeros((0, len(numbers))) if ridge is None else ridge)
    best, rolled = problem.cost(numbers, starts)
    if not np.isfinite(best):
        return None
    damping = 1e-4
    for _ in range(STEPS):
        normal, right = problem.equations(numbers, starts, rolled)
        if not np.isfinite(normal).all():
            return None
        scale = np.sqrt(np.diag(normal).clip(1e-300))
        scaled = normal / scale / scale[:, None]
        gained = 0.0
        for _ in range(TRIES):
            move = np.linalg.solve(scaled + damping * np.eye(len(scale)), right / scale) / scale
            new, begun = (
                numbers + move[: len(numbers)],
                starts + move[len(numbers) :].reshape(-1, 2),
            )
            tried, path = problem.cost(new, begun)
            gained = best - tried
            if gained > 0:
                numbers, starts, best, rolled = new, begun, tried, path
                damping = max(damping / 20, 1e-10)
                break
            damping *= 20
        if gained < ENOUGH * best:
            break
    inverse = np.linalg.pinv(scaled, rcond=1e-13, hermitian=True) / scale / scale[:, None]
    off = np.where(pieces.seen, pieces.x - rolled[:-1].T, 0.0)
    n = len(numbers)
    return Fit(numbers, starts, float((off**2).sum()), inverse[:n, :n])


def fit_stages(
    law: Law,
    numbers: np.ndarray,
    starts: np.ndarray,
    pieces: Pieces,
    ties: tuple[tuple[float, float], ...],
    ridge: np.ndarray | None = None,
    most: float = np.inf,
) -> Fit | None:
    """As :func:`fit_law`, the pieces first apart and then tied, ever closer.

    Squares above ``most`` are given up at once: tied pieces fit no better.
    """
    fit = fit_law(law, numbers, starts, pieces, None, ridge)
    for tie in ties:
        if fit is None or fit.squares > most:
            return None
        fit = fit_law(law, fit.numbers, fit.starts, pieces, tie, ridge)
    return fit


@dataclass(frozen=True)
class _Problem:
    """Least squares of a law's numbers ``(n,)`` and of the pieces' starts, flat after them."""

    law: Law
    pieces: Pieces
    tie: tuple[float, float] | None
    ridge: np.ndarray

    def cost(self, numbers: np.ndarray, starts: np.ndarray) -> tuple[float, np.ndarray]:
        """Squares, infinite for a roll that goes astray; and the roll ``(frames + 1, pieces)``."""
        rolled = roll(self.law, numbers[:, None], starts.T[:, :, None], self.pieces)[..., 0]
        seen = self.pieces.seen
        off = np.where(seen, self.pieces.x - rolled[:-1].T, 0.0)
        with np.errstate(all="ignore"):
            total = (off**2).sum() + ((self.ridge @ numbers) ** 2).sum()
            total += (self.breaks(rolled, starts) ** 2).sum()
        spread = np.nanmax(self.pieces.x) - np.nanmin(self.pieces.x)
        near = np.abs(off).max() < FAR * spread
        return (float(total) if np.isfinite(total) and near else np.inf), rolled

    def breaks(self, rolled: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """How far pieces start from where the ones before them end, ``(pieces - 1, 2)``."""
        if self.tie is None:
            return np.zeros((len(starts) - 1, 2))
        ends = np.stack([rolled[-2], rolled[-1]], -1)
        follows = self.pieces.follows[1:, None]
        return np.where(follows, starts[1:] - ends[:-1], 0.0) / np.array(self.tie)

    def equations(
        self, numbers: np.ndarray, starts: np.ndarray, rolled: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix and right side of a Gauss-Newton step."""
        by = self._derivatives(numbers, starts)
        n, count = len(numbers), len(starts)
        seen = self.pieces.seen
        off = np.where(seen, self.pieces.x - rolled[:-1].T, 0.0)
        rows = np.where(seen[..., None], by[:-1].swapaxes(0, 1), 0.0)  # (pieces, frames, n + 2)
        normal, right = np.zeros((n + 2 * count,) * 2), np.zeros(n + 2 * count)
        square = np.einsum("pfi,pfj->pij", rows, rows)
        along = np.einsum("pfi,pf->pi", rows, off)
        normal[:n, :n] = square[:, :n, :n].sum(0) + self.ridge.T @ self.ridge
        right[:n] = along[:, :n].sum(0) - self.ridge.T @ (self.ridge @ numbers)
        for p in range(count):
            own = slice(n + 2 * p, n + 2 * p + 2)
            normal[own, own] += square[p, n:, n:]
            normal[:n, own] += square[p, :n, n:]
            normal[own, :n] += square[p, n:, :n]
            right[own] += along[p, n:]
        if self.tie is not None:
            ends = by[-2:].transpose(1, 0, 2)  # (pieces, 2, n + 2)
            broken = self.breaks(rolled, starts)
            for p in map(int, np.flatnonzero(self.pieces.follows[1:])):
                weight = 1 / np.array(self.tie)[:, None]
                row = np.zeros((2, n + 2 * count))
                row[:, :n] = -ends[p, :, :n] * weight
                row[:, n + 2 * p : n + 2 * p + 2] = -ends[p, :, n:] * weight
                row[:, n + 2 * p + 2 : n + 2 * p + 4] = np.eye(2) * weight
                normal += row.T @ row
                right -= row.T @ broken[p]
        return normal, right

    def _derivatives(self, numbers: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Of the roll by the numbers and by each piece's start, ``(frames + 1, pieces, n + 2)``."""
        n = len(numbers)
        spread = float(np.nanstd(self.pieces.x))
        pace = spread / float(np.ptp(self.pieces.times[0])) + float(np.std(starts[:, 1]))
        nudge = 1e-5 * (np.abs(numbers) + 1e-3 * np.abs(numbers).max() + 1e-9)
        sizes = np.concatenate([nudge, [1e-5 * spread, 1e-5 * pace]])
        many = np.tile(numbers[:, None], (1, n + 3))
        many[np.arange(n), np.arange(n)] += nudge
        begun = np.tile(starts.T[:, :, None], (1, 1, n + 3))
        begun[0, :, n] += sizes[n]
        begun[1, :, n + 1] += sizes[n + 1]
        rolled = roll(self.law, many, begun, self.pieces)
        return (rolled[..., :-1] - rolled[..., -1:]) / sizes
