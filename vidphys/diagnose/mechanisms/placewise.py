"""Errors that go with the place: what a lens or the background does to a body, it does again.

A body that swings is off by the same at every swing, so ever more swings tell its numbers no
better. Such an error is a smooth random field over the picture, in modes of a box around the path
(Solin and Sarkka 2020, Statistics and Computing 30).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

REACHES = (0.35, 1.0)  # over the spread of the motion: how far an error stays the same
SIZES = (0.5, 1.5, 5.0, 15.0)  # over the white noise
MARGIN = 1.5  # reaches, by which the box is wider than the path
FINEST = 2.5  # over the reach, radians: modes beyond it have no size
MOST = 40  # modes


@dataclass(frozen=True)
class Equations:
    """Normal equations of a law's numbers, under errors of one shape in units of the white noise.

    Args:
        gram, moment, square: of the slopes, of those with what is missed, of what is missed.
        log_size: log determinant of the errors' covariance.
    """

    gram: np.ndarray
    moment: np.ndarray
    square: float
    log_size: float


@dataclass(frozen=True)
class Field:
    """Modes of an error that goes with the place.

    Args:
        values: of the modes at each frame of each stretch, ``(f, m)``.
        rates: squared wave number of each mode, radians over the spread, ``(m,)``.
        space: dimensions of the box.
    """

    values: tuple[np.ndarray, ...]
    rates: np.ndarray
    space: int

    def sizes(self, reach: float) -> np.ndarray:
        """Variance of each mode, where that of the error is 1, ``(m,)``."""
        density = (2 * np.pi * reach**2) ** (self.space / 2) * np.exp(-0.5 * reach**2 * self.rates)
        return np.maximum(density, 1e-12)


def field_of(places: list[np.ndarray], spread: float) -> Field:
    """The modes at places of each stretch ``(f, d)``."""
    scaled = [x / spread for x in places]
    joined = np.concatenate(scaled)
    middle = 0.5 * (joined.min(0) + joined.max(0))
    half = 0.5 * np.ptp(joined, axis=0) + MARGIN * max(REACHES)
    finest = FINEST / min(REACHES)
    counts = np.maximum(np.ceil(2 * half * finest / np.pi), 1).astype(int)
    which = np.stack(np.meshgrid(*[np.arange(1, n + 1) for n in counts], indexing="ij"), -1)
    waves = which.reshape(-1, len(half)) * np.pi / (2 * half)
    rates = (waves**2).sum(-1)
    kept = np.argsort(rates, kind="stable")[:MOST]
    waves, rates = waves[kept], rates[kept]
    values = tuple(
        np.prod(np.sin((x - middle + half)[:, None] * waves) / np.sqrt(half), axis=-1)
        for x in scaled
    )
    return Field(values, rates, len(half))


def without(
    field: np.ndarray, crossed: np.ndarray, told: np.ndarray, sizes: np.ndarray, rest: Equations
) -> Equations:
    """The equations where such an error of these variances may be beside the others.

    Args:
        field: Gram matrix of the modes ``(m, m)``, the same along every axis.
        crossed: products of the modes and the slopes, of each axis, ``(d, m, p)``.
        told: products of the modes and what is missed, ``(d, m)``.
        sizes: variance of each mode, over the white noise's, ``(m,)``.
        rest: the equations without it.
    """
    root = np.sqrt(sizes)
    factor = cho_factor(np.eye(len(root)) + root[:, None] * field * root)
    log_size = 2 * float(np.log(np.diag(factor[0])).sum())
    gram, moment = rest.gram.copy(), rest.moment.copy()
    square, size = rest.square, rest.log_size
    for slopes, missed in zip(crossed, told, strict=True):
        solved = root[:, None] * cho_solve(
            factor, root[:, None] * np.column_stack([slopes, missed])
        )
        gram -= slopes.T @ solved[:, :-1]
        moment -= slopes.T @ solved[:, -1]
        square -= float(missed @ solved[:, -1])
        size += log_size
    return Equations(gram, moment, square, size)
