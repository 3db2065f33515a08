"""Errors that go with the place: what a lens or the background does to a body, it does again.

A body that swings is off by the same at every swing, so ever more swings tell its numbers no
better. Such an error is a smooth random field over the picture, in modes of a box around the path
(Solin and Sarkka 2020, Statistics and Computing 30).

Where a camera saw the body, the error may grow or shrink as time goes on: who follows a body takes
some of what moves with it for the body, the coils of a spring or a shadow, and less of it as the
swing dies down. What that does to a swing is what friction does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from vidphys.diagnose.mechanisms.measurement import Stretch

REACHES = (0.35, 1.0)  # over the spread of the motion: how far an error stays the same
SIZES = (0.5, 1.5, 5.0, 15.0)  # over the white noise
MARGIN = 1.5  # reaches, by which the box is wider than the path
FINEST = 2.5  # over the reach, radians: modes beyond it have no size
MOST = 40  # modes
SLOWLY = 0.003  # by which a tracked motion may be told too large at first, and too small at last


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
    """Modes of an error that goes with the place, and of one that grows or shrinks with time.

    Args:
        values: of the modes at each frame of each stretch, ``(f, m + d)``; those of the error that
            changes with time are last.
        rates: squared wave number of each of the first modes, radians over the spread, ``(m,)``.
        slow: standard deviation of each of the others.
    """

    values: tuple[np.ndarray, ...]
    rates: np.ndarray
    slow: np.ndarray

    def sizes(self, size: float, reach: float, white: float) -> np.ndarray:
        """Variance of each mode over the white noise's, ``(m + d,)``.

        Args:
            size: of the error that goes with the place, over the white noise.
            reach: of that error, over the spread.
            white: standard deviation of the noise, unit of the positions.
        """
        density = (2 * np.pi * reach**2) ** (len(self.slow) / 2)
        density *= np.maximum(np.exp(-0.5 * reach**2 * self.rates), 1e-12)
        return np.concatenate([size**2 * density, (self.slow / white) ** 2])


def field_of(stretches: Sequence[Stretch], spread: float, slowly: float) -> Field:
    """The modes at the places where a law has a body, of each stretch.

    Args:
        stretches: frames of the body, with those places.
        spread: of the motion, unit of the positions.
        slowly: see :data:`SLOWLY`.
    """
    places = [s.places for s in stretches]
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
        np.column_stack(
            [
                np.prod(np.sin((x - middle + half)[:, None] * waves) / np.sqrt(half), axis=-1),
                (x - joined.mean(0)) * np.linspace(-1, 1, len(x))[:, None],
            ]
        )
        for x in scaled
    )
    return Field(values, rates, np.full(len(half), slowly * spread))


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
