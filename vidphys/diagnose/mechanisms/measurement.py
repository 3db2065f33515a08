"""What stands between a law and the positions that were recorded of it.

Three errors are told apart: white noise; a smooth error that forgets itself in a while, as a lens,
perspective or a tracker's slow mistakes leave it (an Ornstein-Uhlenbeck process); and outliers. The
likelihood needs no matrix of all frames: the inverse covariance of the smooth error is tridiagonal
(Rue and Held 2005, section 1.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from vidphys.statistics import ROBUST

SHARES = np.concatenate([[0.0], np.geomspace(0.3, 300.0, 9)])  # of the smooth error, over the white
TIMES = (3.0, 8.0, 20.0, 50.0)  # frames in which it forgets itself
OUTLIER = 4.0  # standard deviations from which an error counts less
LEAST_TRUST = 1e-4


@dataclass(frozen=True)
class Errors:
    """Sizes of the errors of one coordinate.

    Args:
        white: standard deviation of what differs from frame to frame, unit of the positions.
        smooth: of the error that lasts; 0 where there is none.
        memory: seconds in which that error forgets itself.
    """

    white: float
    smooth: float
    memory: float

    @property
    def total(self) -> float:
        """Standard deviation of both together."""
        return float(np.hypot(self.white, self.smooth))


@dataclass(frozen=True)
class Stretch:
    """Frames of one body in a row: times ``(t,)``, positions ``(t, d)``, all seen.

    Args:
        trust: weight of each frame, ``(t,)``; an outlier has less than 1.
    """

    times: np.ndarray
    places: np.ndarray
    trust: np.ndarray

    def upto(self, count: int) -> Stretch:
        """Its first frames."""
        return Stretch(self.times[:count], self.places[:count], self.trust[:count])


class Covariance:
    """Of the errors of one stretch, without its matrix."""

    def __init__(self, times: np.ndarray, trust: np.ndarray, errors: Errors) -> None:
        self.precision = trust / errors.white**2
        self.log_size = -float(np.log(self.precision).sum())
        self.factor = None
        if errors.smooth <= 0 or len(times) < 3:
            return
        kept = np.exp(-np.diff(times) / errors.memory)
        fresh = errors.smooth**2 * (1 - kept**2)
        bands = np.zeros((2, len(times)))
        bands[1, 0] = 1 / errors.smooth**2
        bands[1, 1:] = 1 / fresh
        bands[1, :-1] += kept**2 / fresh
        bands[0, 1:] = -kept / fresh
        bands[1] += self.precision
        self.factor = cholesky_banded(bands)
        self.log_size += 2 * float(np.log(self.factor[1]).sum())
        self.log_size += float(np.log(fresh).sum() + np.log(errors.smooth**2))

    def solve(self, x: np.ndarray) -> np.ndarray:
        """Inverse covariance times ``(t, k)``."""
        weighed = self.precision[:, None] * x
        if self.factor is None:
            return weighed
        smooth = cho_solve_banded((self.factor, False), weighed)
        return weighed - self.precision[:, None] * smooth


def log_likelihood(
    stretches: Sequence[Stretch], residuals: Sequence[np.ndarray], errors: Errors
) -> float:
    """Of residuals ``(t, d)`` under errors of these sizes."""
    total = 0.0
    for stretch, residual in zip(stretches, residuals, strict=True):
        covariance = Covariance(stretch.times, stretch.trust, errors)
        quadratic = float((residual * covariance.solve(residual)).sum())
        space = residual.shape[1]
        constant = residual.size * np.log(2 * np.pi)
        total -= 0.5 * (quadratic + space * covariance.log_size + constant)
    return total


def likeliest_errors(
    stretches: Sequence[Stretch], residuals: Sequence[np.ndarray], least: float
) -> tuple[Errors, float]:
    """The sizes of the errors under which residuals are likeliest, and their log likelihood.

    Args:
        least: white noise that there is in any case, unit of the positions.
    """
    count = sum(r.size for r in residuals)
    best: tuple[Errors, float] | None = None
    for unit in unit_errors(stretches):
        square = 0.0
        for stretch, r in zip(stretches, residuals, strict=True):
            square += float((r * Covariance(stretch.times, stretch.trust, unit).solve(r)).sum())
        white = max(float(np.sqrt(square / count)), least)
        errors = Errors(white, white * unit.smooth, unit.memory)
        likely = log_likelihood(stretches, residuals, errors)
        if best is None or likely > best[1]:
            best = errors, likely
    assert best is not None
    return best


def unit_errors(stretches: Sequence[Stretch]) -> list[Errors]:
    """Errors that are tried, in units of the white noise."""
    interval = float(np.median(np.concatenate([np.diff(s.times) for s in stretches])))
    longest = max(float(s.times[-1] - s.times[0]) for s in stretches)
    return [
        Errors(1.0, float(share), min(frames * interval, longest))
        for share in SHARES
        for frames in (TIMES if share else TIMES[:1])
    ]


def trusted(stretches: Sequence[Stretch], residuals: Sequence[np.ndarray]) -> list[Stretch]:
    """The stretches with less trust in frames that a law misses suddenly.

    An error that lasts is no outlier: what counts is the distance from the neighbours' error.
    """
    sudden = [_sudden(r) for r in residuals]
    joined = np.concatenate(sudden)
    scale = ROBUST * float(np.median(joined)) / 0.8 + np.finfo(float).tiny
    return [
        replace(s, trust=np.clip((OUTLIER * scale / np.maximum(x, scale)) ** 2, LEAST_TRUST, 1.0))
        for s, x in zip(stretches, sudden, strict=True)
    ]


def _sudden(residual: np.ndarray) -> np.ndarray:
    """Distance of each frame's error from the median of its neighbourhood, ``(t,)``."""
    if len(residual) < 5:
        return np.linalg.norm(residual - np.median(residual, 0), axis=-1)
    padded = np.pad(residual, ((2, 2), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
    return np.linalg.norm(residual - np.median(windows, -1), axis=-1)
