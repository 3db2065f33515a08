"""What is left of a swing: alike every time, or with a rate of its own.

A lens, perspective or a rolling shutter errs alike at every swing, as does a law whose force is not
quite the body's; a tracker's slow mistakes have no rate. What is left of one bob of a double
pendulum has a rate of its own: something moves with it that was not followed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.measurement import (
    Covariance,
    Errors,
    Shapes,
    Stretch,
    trusted,
)

HARMONICS = 4  # of the swing, that an error of the picture may have
SLOWLY = 2  # power of the time, by which it may go over to another
FEWEST = 2.0  # swings, of the body and of what is left of it, that are seen at least
FINER = 3  # times the frequencies that so many seconds tell apart
QUICKEST = 0.25  # of the frames' rate: quicker is what differs from frame to frame
LARGE = 0.01  # of the spread, that it must have
SLIGHT = 0.005  # of it, that what is alike at every swing must have
LEAST = 1e-9  # of it, that noise is
SURELY = 10.0  # of log likelihood after its price


@dataclass(frozen=True)
class OwnSwing:
    """What swings at a rate of its own.

    Args:
        rate: radians per second.
        size: root mean square, unit of the positions.
    """

    rate: float
    size: float


@dataclass(frozen=True)
class _Swing:
    """One body's frames in the longest clip.

    Args:
        stretch: of them, with less trust in outliers.
        missed: by the law, ``(t, d)``.
        alike: columns of what is alike at every swing, ``(t, m)``.
    """

    stretch: Stretch
    missed: np.ndarray
    alike: np.ndarray

    @property
    def seconds(self) -> float:
        return float(self.stretch.times[-1] - self.stretch.times[0])

    @cached_property
    def shapes(self) -> Shapes:
        """Of errors that are tried."""
        return Shapes([self.stretch])

    def likeliest(self, left: np.ndarray, spread: float) -> tuple[Errors, float]:
        """Of what is left ``(t, d)``."""
        return self.shapes.likeliest([left], LEAST * spread)

    def without(self, columns: np.ndarray, errors: Errors) -> np.ndarray:
        """What is missed, less what columns ``(t, m)`` have of it."""
        solved = self.whitened(columns, errors)
        found = np.linalg.lstsq(solved.T @ columns, solved.T @ self.missed, rcond=None)[0]
        return self.missed - columns @ found

    def whitened(self, x: np.ndarray, errors: Errors) -> np.ndarray:
        return Covariance(self.stretch.times, self.stretch.trust, errors).solve(x)

    def beside(self, rate: float) -> np.ndarray:
        """The columns with a swing at a rate."""
        turn = rate * self.stretch.times
        return np.column_stack([self.alike, np.cos(turn), np.sin(turn)])


def own_swing(fit: Fit) -> OwnSwing | None:
    """What is left of one body's swing and swings by itself, if anything does.

    Args:
        fit: of a law; only of one that swings in one coordinate, without walls, it is asked.
    """
    swing = _swing_of(fit)
    if swing is None:
        return None
    times, turn = swing.stretch.times, 2 * np.pi
    quickest = QUICKEST * turn / float(np.median(np.diff(times)))
    rates = np.arange(FEWEST * turn / swing.seconds, quickest, turn / swing.seconds / FINER)
    if not len(rates):
        return None
    rest = swing.without(swing.alike, fit.errors)
    if _size(rest) < LARGE * fit.spread:  # no swing takes more away than is left
        return None
    errors, likely = swing.likeliest(rest, fit.spread)

    def leaves(rate: float) -> float:
        left = swing.without(swing.beside(rate), errors)
        return float((left * swing.whitened(left, errors)).sum())

    rate = float(min(rates, key=leaves))
    size, gain = _gain(swing, swing.beside(rate), rest, errors, fit.spread)
    price = 0.5 * np.log(rest.size) * (2 * rest.shape[1] + 1)
    if gain - likely - price < SURELY or size < LARGE * fit.spread:
        return None
    return OwnSwing(rate, size)


def alike_every_time(fit: Fit) -> bool | None:
    """Whether what is left of one body's swing is the same at every swing, beyond noise.

    Args:
        fit: as of :func:`own_swing`; ``None`` where too little is seen of a swing.
    """
    swing = _swing_of(fit)
    if swing is None:
        return None
    missed = swing.missed
    errors, likely = swing.likeliest(missed, fit.spread)
    size, gain = _gain(swing, swing.alike, missed, errors, fit.spread)
    price = 0.5 * np.log(missed.size) * swing.alike.shape[1] * missed.shape[1]
    return gain - likely - price > SURELY and size > SLIGHT * fit.spread


def _gain(
    swing: _Swing, columns: np.ndarray, rest: np.ndarray, errors: Errors, spread: float
) -> tuple[float, float]:
    """Size of what columns take away, and the log likelihood of what they leave."""
    for _ in range(2):
        left = swing.without(columns, errors)
        errors, likely = swing.likeliest(left, spread)
    return _size(rest - left), likely


def _size(x: np.ndarray) -> float:
    """Root mean square over time of places ``(t, d)``."""
    return float(np.sqrt((x**2).sum(1).mean()))


def _swing_of(fit: Fit) -> _Swing | None:
    """``None`` where a law does not swing in one coordinate, or too little is seen of it."""
    law = fit.model.law
    if law.restoring not in ("pendulum", "trap") or law.coordinates > 1 or law.walls or law.inputs:
        return None
    number = int(np.argmax([len(clip.times) for clip in fit.clips]))
    clip, missed = fit.clips[number], fit.residuals[number]
    stretch = trusted([clip.stretches[0]], [missed])[0]
    phase = _phase(fit.model.coordinates(fit.values, fit.clips)[number][clip.seen[0], :, 0])
    long = float(stretch.times[-1] - stretch.times[0])
    alike = _alike(phase, stretch.times / long)
    few = abs(phase[-1] - phase[0]) < FEWEST * 2 * np.pi
    return None if few or len(missed) < alike.shape[1] + 4 else _Swing(stretch, missed, alike)


def _phase(s: np.ndarray) -> np.ndarray:
    """Radians of a swing, of its coordinate and rate ``(t, 2)``."""
    away = s - 0.5 * (s.max(0) + s.min(0))
    away[:, 1] = s[:, 1]
    place, rate = (away / (np.sqrt((away**2).mean(0)) + np.finfo(float).tiny)).T
    return np.unwrap(np.arctan2(-rate, place))


def _alike(phase: np.ndarray, share: np.ndarray) -> np.ndarray:
    """What is alike at every swing, or goes slowly over to something else: columns ``(t, m)``."""
    turns = np.arange(1, HARMONICS + 1) * phase[:, None]
    each = np.column_stack([np.ones(len(phase)), np.cos(turns), np.sin(turns)])
    return np.column_stack([share[:, None] ** k * each for k in range(SLOWLY + 1)])
