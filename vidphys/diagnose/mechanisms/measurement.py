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
from scipy.linalg.lapack import dpbtrf, dpbtrs

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
        return self.at(slice(count))

    def at(self, rows: slice | np.ndarray) -> Stretch:
        """Some of its frames."""
        return Stretch(self.times[rows], self.places[rows], self.trust[rows])


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
        # LAPACK itself: scipy's checks take longer than a few hundred frames do.
        self.factor, failed = dpbtrf(bands)
        if failed:
            raise np.linalg.LinAlgError("Covariance: the errors' precision is not positive")
        self.log_size += 2 * float(np.log(self.factor[1]).sum())
        self.log_size += float(np.log(fresh).sum() + np.log(errors.smooth**2))

    def solve(self, x: np.ndarray) -> np.ndarray:
        """Inverse covariance times ``(t, k)``."""
        weighed = self.precision[:, None] * x
        if self.factor is None:
            return weighed
        smooth, _ = dpbtrs(self.factor, weighed)
        return weighed - self.precision[:, None] * smooth


class Shapes:
    """The errors that are tried of some stretches, in units of their white noise."""

    def __init__(self, stretches: Sequence[Stretch]) -> None:
        self.tried = [
            (unit, [Covariance(s.times, s.trust, unit) for s in stretches])
            for unit in unit_errors(stretches)
        ]

    def likeliest(self, residuals: Sequence[np.ndarray], least: float) -> tuple[Errors, float]:
        """The errors under which residuals ``(t, d)`` are likeliest, and their log likelihood.

        Args:
            residuals: of each stretch.
            least: white noise that there is in any case, unit of the positions.
        """
        count = sum(r.size for r in residuals)
        best: tuple[Errors, float] | None = None
        for unit, covariances in self.tried:
            each = list(zip(residuals, covariances, strict=True))
            square = sum(float((r * c.solve(r)).sum()) for r, c in each)
            white = max(float(np.sqrt(square / count)), least)
            size = sum(r.shape[1] * c.log_size for r, c in each) + 2 * count * np.log(white)
            likely = -0.5 * (square / white**2 + size + count * np.log(2 * np.pi))
            if best is None or likely > best[1]:
                best = Errors(white, white * unit.smooth, unit.memory), float(likely)
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
