"""Weighted linear regression in the weak form, for many sets of columns over one set of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.weak.windows import Windows

RIDGE = 1e-10  # over the mean square of a column
UNTOLD = 10.0  # times what rounding leaves of an eigenvalue, up to which it is none
NOTHING = 1e-200  # squared size of a column that is zero for all that can be told of it


@dataclass(frozen=True)
class Rows:
    """What the test functions read, one row each.

    Args:
        x: of the columns, ``(r, p)``.
        y: of the frames, ``(r,)``.
        kicks: variance that unit random kicks give each row, ``(r,)``.
        window: number of the window, ``(r,)``.
    """

    x: np.ndarray
    y: np.ndarray
    kicks: np.ndarray
    window: np.ndarray


def rows_of(windows: Windows, columns: np.ndarray) -> Rows:
    """Rows of columns of accelerations ``(w, m, n, d, p)``."""
    there = windows.informative  # (w, n, k)
    space = windows.frames.shape[-1]
    x = windows.read(columns)[there].reshape(-1, columns.shape[-1])
    y = windows.measured[there].reshape(-1)
    kicks = np.repeat(windows.tests[1][there], space)
    number = np.broadcast_to(np.arange(len(windows))[:, None, None], there.shape)
    return Rows(x, y, kicks, np.repeat(number[there], space))


@dataclass(frozen=True)
class Normal:
    """Normal equations over all columns, for one strength of random kicks.

    Args:
        gram: ``(p, p)``.
        moment: ``(p,)``.
        power: weighted sum of squares of y.
        count: rows.
        log_weight: sum of the logarithms of the rows' relative variances.
    """

    gram: np.ndarray
    moment: np.ndarray
    power: float
    count: int
    log_weight: float

    def solve(self, chosen: Sequence[int]) -> np.ndarray:
        """Coefficients of some columns."""
        return self.solve_each(np.asarray(chosen, int)[None])[0]

    def misfit(self, chosen: Sequence[int], coefficients: np.ndarray) -> float:
        """Weighted sum of squared residuals."""
        return float(self.misfit_each(np.asarray(chosen, int)[None], coefficients[None])[0])

    def solve_each(self, chosen: np.ndarray) -> np.ndarray:
        """Coefficients ``(k, c)`` of each of so many choices of columns, ``(k, c)``."""
        gram = self.gram[chosen[:, :, None], chosen[:, None, :]]
        size = np.sqrt(np.maximum(self.gram[chosen, chosen], np.finfo(float).tiny))
        scaled = gram / (size[:, :, None] * size[:, None, :]) + RIDGE * np.eye(chosen.shape[1])
        moment = self.moment[chosen] / size
        return np.linalg.solve(scaled, moment[..., None])[..., 0] / size

    def misfit_each(self, chosen: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """Weighted sums of squared residuals ``(k,)`` of each."""
        gram = self.gram[chosen[:, :, None], chosen[:, None, :]]
        told = (gram @ coefficients[..., None])[..., 0] - 2 * self.moment[chosen]
        left = self.power + (coefficients * told).sum(-1)
        return np.maximum(left, np.finfo(float).tiny)

    def log_likelihood(self, misfit: float, floor: float = 0.0) -> float:
        """Of the best variance, which is at least ``floor`` squared."""
        variance = max(misfit / self.count, floor**2)
        spread = misfit / variance + self.count * np.log(2 * np.pi * variance)
        return float(-0.5 * (spread + self.log_weight))


def normal_equations(rows: Rows, ratio: float = 0.0, keep: np.ndarray | None = None) -> Normal:
    """Normal equations with variances 1 + ratio * kicks.

    Args:
        rows: see :class:`Rows`.
        ratio: of the kicks' variance (per second) to that of the noise.
        keep: rows to use; all by default.
    """
    x, y, kicks = rows.x, rows.y, rows.kicks
    if keep is not None:
        x, y, kicks = x[keep], y[keep], kicks[keep]
    spread = 1 + ratio * kicks
    weighted = x / spread[:, None]
    return Normal(
        weighted.T @ x,
        weighted.T @ y,
        float((y**2 / spread).sum()),
        len(y),
        float(np.log(spread).sum()),
    )


def gram_inverse(gram: np.ndarray) -> np.ndarray:
    """Inverse of a Gram matrix ``(p, p)``; what its rows cannot tell gets a very large variance."""
    told, directions = _directions(gram)
    return (directions / np.maximum(told, len(gram) * np.finfo(float).eps)) @ directions.T


def gram_solved(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Least squares by a Gram matrix; what its rows cannot tell stays zero, ``(p,)``."""
    told, directions = _directions(gram)
    shows = told > UNTOLD * len(gram) * np.finfo(float).eps
    return (directions[:, shows] / told[shows]) @ (directions[:, shows].T @ right)


def _directions(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues of a Gram matrix of columns of unit size, and eigenvectors as columns count."""
    size = np.diag(gram)
    scale = np.sqrt(np.where(size > NOTHING, size, 1.0))
    told, directions = np.linalg.eigh(gram / np.outer(scale, scale))
    return told, directions / scale[:, None]
