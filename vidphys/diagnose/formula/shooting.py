"""Laws of one coordinate fitted to where it was seen: rolled from piece to piece, all at once.

A recording is cut into pieces, each with a start of its own; the law's numbers are common.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.formula.rolling import rolled

Columns = Callable[[np.ndarray, np.ndarray], np.ndarray]
ROWS = 600  # of a table of the force
MARGIN, NEAREST = 0.25, 0.6  # of the width, that it goes beyond; and of a lowest place above zero
STEPS, TRIES = 40, 6
PATIENCE, FAR_ABOVE = 8, 3.0  # steps until a law is given up that misses so many times too much
FAR = 1e3  # times the spread of the places, beyond which a roll has gone astray
FINEST = 6  # steps in a frame interval, at most
TURN = 0.2  # radians of the fastest swing in a step; longer ones lose energy, as by a friction
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

    def joined(self) -> Pieces:
        """Each clip as one piece."""
        clips = int((~self.follows).sum())
        x, times = (part[:, :-1].reshape(clips, -1) for part in (self.x, self.times))
        return replace(self, x=x, times=times, follows=np.zeros(clips, bool))

    def stepped(self, fastest: float) -> Pieces:
        """The same, with steps short enough for a swing of so many radians per second."""
        widest = float(np.max(np.diff(self.times, axis=1)))
        return replace(self, substeps=int(np.clip(np.ceil(widest * fastest / TURN), 1, FINEST)))


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
    return Pieces(np.stack(pieces), np.stack(seconds), np.array(follows), 1).stepped(fastest)


@dataclass(frozen=True)
class Law:
    """An acceleration f(x) + g(v) with numbers; the last are those of the speed.

    Args:
        columns: of the force's numbers ``(n,)`` and of places ``(m,)``: the force, and its
            derivatives by its numbers, ``(m, 1 + n)``.
        speeds: words of the speed, of :data:`vidphys.diagnose.formula.rolling.SPEEDS`.
        low, high: places that were seen.
    """

    columns: Columns
    speeds: tuple[str, ...]
    low: float
    high: float

    def roll(
        self, numbers: np.ndarray, starts: np.ndarray, times: np.ndarray, substeps: int
    ) -> np.ndarray:
        """Paths and their derivatives; see :func:`vidphys.diagnose.formula.rolling.rolled`.

        Args:
            numbers: ``(n,)``.
            starts: place and speed of each piece, ``(pieces, 2)``.
            times: seconds, ``(pieces, frames)``.
            substeps: of a frame interval.
        """
        beyond = MARGIN * (self.high - self.low)
        low = self.low - beyond
        if self.low > 0:
            low = max(low, NEAREST * self.low)
        places, step = np.linspace(low, self.high + beyond, ROWS, retstep=True)
        count = len(numbers) - len(self.speeds)
        table = self.columns(numbers[:count], places)
        return rolled(
            times, starts, table, low, float(step), self.speeds, numbers[count:], substeps
        )


@np.errstate(over="ignore", invalid="ignore")  # trials that fly apart are given up
def fit_law(
    law: Law,
    numbers: np.ndarray,
    starts: np.ndarray,
    pieces: Pieces,
    tie: tuple[float, float] | None = None,
    ridge: np.ndarray | None = None,
    most: float = np.inf,
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
        most: squares, far above which a law is given up.

    Returns:
        The fit; ``None`` where no roll stays near what was seen.
    """
    problem = _Problem(law, pieces, tie, np.zeros((0, len(numbers))) if ridge is None else ridge)
    best, path = problem.cost(numbers, starts)
    if not np.isfinite(best):
        return None
    damping = 1e-4
    for step in range(STEPS):
        if step >= PATIENCE and best > FAR_ABOVE * most:
            return None
        normal, right = problem.equations(numbers, starts, path)
        if not np.isfinite(normal).all():
            return None
        scale = np.sqrt(np.diag(normal).clip(1e-300))
        scaled = normal / scale / scale[:, None]
        gained = 0.0
        for _ in range(TRIES):
            move = np.linalg.solve(scaled + damping * np.eye(len(scale)), right / scale) / scale
            new = numbers + move[: len(numbers)]
            begun = starts + move[len(numbers) :].reshape(-1, 2)
            tried, rolled_on = problem.cost(new, begun)
            gained = best - tried
            if gained > 0:
                numbers, starts, best, path = new, begun, tried, rolled_on
                damping = max(damping / 20, 1e-10)
                break
            damping *= 20
        if not gained > ENOUGH * best:
            break
    inverse = np.linalg.pinv(scaled, rcond=1e-13, hermitian=True) / scale / scale[:, None]
    n = len(numbers)
    return Fit(numbers, starts, float((problem.off(path) ** 2).sum()), inverse[:n, :n])


def fit_stages(
    law: Law,
    numbers: np.ndarray,
    starts: np.ndarray,
    pieces: Pieces,
    ties: tuple[tuple[float, float], ...],
    ridge: np.ndarray | None = None,
) -> Fit | None:
    """As :func:`fit_law`, the pieces first apart and then tied, ever closer."""
    fit = fit_law(law, numbers, starts, pieces, None, ridge)
    for tie in ties:
        if fit is None:
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
        """Squares, infinite for a roll that goes astray; and the roll, see :meth:`Law.roll`."""
        pieces = self.pieces
        path = self.law.roll(numbers, starts, pieces.times, pieces.substeps)
        off = self.off(path)
        with np.errstate(all="ignore"):
            total = (off**2).sum() + ((self.ridge @ numbers) ** 2).sum()
            total += (self.breaks(path, starts) ** 2).sum()
        spread = np.nanmax(pieces.x) - np.nanmin(pieces.x)
        near = np.abs(off).max() < FAR * spread
        return (float(total) if np.isfinite(total) and near else np.inf), path

    def off(self, path: np.ndarray) -> np.ndarray:
        """What was seen less the roll, ``(pieces, frames)``; zero where nothing was seen."""
        return np.where(self.pieces.seen, self.pieces.x - path[:, :-1, 0], 0.0)

    def breaks(self, path: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """How far pieces start from where the ones before them end, ``(pieces - 1, 2)``."""
        if self.tie is None:
            return np.zeros((len(starts) - 1, 2))
        follows = self.pieces.follows[1:, None]
        return np.where(follows, starts[1:] - path[:-1, -2:, 0], 0.0) / np.array(self.tie)

    def equations(
        self, numbers: np.ndarray, starts: np.ndarray, path: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix and right side of a Gauss-Newton step."""
        n, count = len(numbers), len(starts)
        off = self.off(path)
        rows = np.where(self.pieces.seen[..., None], path[:, :-1, 1:], 0.0)
        normal, right = np.zeros((n + 2 * count,) * 2), np.zeros(n + 2 * count)
        square = rows.swapaxes(1, 2) @ rows
        along = (rows * off[..., None]).sum(1)
        normal[:n, :n] = square[:, :n, :n].sum(0) + self.ridge.T @ self.ridge
        right[:n] = along[:, :n].sum(0) - self.ridge.T @ (self.ridge @ numbers)
        for p in range(count):
            own = slice(n + 2 * p, n + 2 * p + 2)
            normal[own, own] += square[p, n:, n:]
            normal[:n, own] += square[p, :n, n:]
            normal[own, :n] += square[p, n:, :n]
            right[own] += along[p, n:]
        if self.tie is not None:
            ends = path[:, -2:, 1:]  # (pieces, 2, n + 2)
            broken = self.breaks(path, starts)
            weight = 1 / np.array(self.tie)[:, None]
            for p in map(int, np.flatnonzero(self.pieces.follows[1:])):
                row = np.zeros((2, n + 2 * count))
                row[:, :n] = -ends[p, :, :n] * weight
                row[:, n + 2 * p : n + 2 * p + 2] = -ends[p, :, n:] * weight
                row[:, n + 2 * p + 2 : n + 2 * p + 4] = np.eye(2) * weight
                normal += row.T @ row
                right -= row.T @ broken[p]
        return normal, right
