"""Frequencies and decay rates: of the model by its linearisation, of the data by its spectrum.

The two share nothing but the positions: the second knows no law. It finds the strongest
frequencies by least squares and follows each one's amplitude from stretch to stretch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

PER_PEAK = 10  # trial frequencies in one width of a spectral line
STRETCHES = 8  # of a recording, in which an amplitude is followed
AT_ONCE = 64  # trial frequencies
ONE = 1e-9  # share of their sizes that sines and cosines keep apart, below which they are one
PERIODS = 2.0  # that a stretch must hold
ALIKE = 0.1  # share within which two peaks are one
STRAIGHT = 3  # stretches through which a line leaves too little to tell its error


@dataclass(frozen=True)
class Mode:
    """One oscillation.

    Args:
        frequency: radians per second.
        decay: of its amplitude, per second.
        error: standard error of the decay, where it was measured.
        frequency_error: likewise of the frequency.
    """

    frequency: float
    decay: float
    error: float = float("nan")
    frequency_error: float = float("nan")


def distinct(modes: list[Mode]) -> list[Mode]:
    """One of each frequency: bodies in one trap, or two axes, share theirs."""
    kept: list[Mode] = []
    for mode in modes:
        if not kept or mode.frequency > (1 + ALIKE) * kept[-1].frequency:
            kept.append(mode)
    return kept


def modes_of_data(times: np.ndarray, positions: np.ndarray, count: int) -> list[Mode]:
    """The strongest oscillations of positions ``(t, n, d)``, slowest first."""
    x = positions.reshape(len(times), -1)
    seen = np.isfinite(x).all(1)
    t, x = times[seen], x[seen] - x[seen].mean(0)
    left, frequencies = x, []
    for _ in range(count):
        frequencies.append(_strongest(t, left))
        left = _without(t, left, frequencies[-1])
    return [
        Mode(frequency, *_decay(t, x, frequency, [w for w in frequencies if w != frequency]))
        for frequency in sorted(frequencies)
    ]


def _strongest(t: np.ndarray, x: np.ndarray) -> float:
    """The frequency at which a sine explains most, between one period and the frames' own limit."""
    span, step = t[-1] - t[0], float(np.median(np.diff(t)))
    lowest, highest = 2 * np.pi / span, np.pi / step
    trial = np.linspace(lowest, highest, int(PER_PEAK * (highest - lowest) * span / (2 * np.pi)))
    best = float(trial[int(np.argmax(_explained(t, x, trial)))])
    width = 2 * np.pi / span / PER_PEAK
    finer = minimize_scalar(
        lambda w: _misfit(t, x, w), bounds=(best - width, best + width), method="bounded"
    )
    return float(finer.x)


def _explained(t: np.ndarray, x: np.ndarray, trial: np.ndarray) -> np.ndarray:
    """Of the sum of squares, what a sine of each frequency explains: Lomb's and Scargle's power.

    Args:
        t, x: times ``(t,)`` and what is explained ``(t, k)``.
        trial: evenly spaced frequencies.
    """
    step = trial[1] - trial[0] if len(trial) > 1 else 0.0
    since, out = t - t.mean(), []
    turns = np.exp(1j * step * np.arange(AT_ONCE)[:, None] * since)
    for first in trial[::AT_ONCE]:  # a product of turns costs less than a sine
        wave = turns * np.exp(1j * first * since)
        twice = (wave * wave).sum(1)
        cosines, sines, mixed = len(t) + twice.real, len(t) - twice.real, twice.imag
        turned = (wave @ x).T
        along, across = turned.real, turned.imag
        squares = sines * along**2 - 2 * mixed * along * across + cosines * across**2
        told = cosines * sines - mixed**2
        one = told < ONE * len(t) ** 2  # at the frames' own limit sines and cosines are one
        out.append(np.where(one, 0.0, 2 * squares.sum(0) / np.where(one, 1.0, told)))
    return np.concatenate(out)[: len(trial)]


def _basis(t: np.ndarray, *frequencies: float) -> np.ndarray:
    middle = t - t.mean()
    waves = [wave(w * middle) for w in frequencies for wave in (np.cos, np.sin)]
    return np.stack([np.ones_like(t), *waves], -1)


def _misfit(t: np.ndarray, x: np.ndarray, *frequencies: float) -> float:
    basis = _basis(t, *frequencies)
    return float(((x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0]) ** 2).sum())


def _stretches(t: np.ndarray, frequency: float) -> list[np.ndarray]:
    count = int((t[-1] - t[0]) * frequency / (2 * np.pi * PERIODS))
    edges = np.linspace(t[0], t[-1], max(2, min(STRETCHES, count)) + 1)
    return [(t >= a) & (t <= b) for a, b in zip(edges, edges[1:], strict=False)]


def _decay(
    t: np.ndarray, x: np.ndarray, frequency: float, others: list[float]
) -> tuple[float, float]:
    """Slope of the logarithm of the amplitude over stretches of the recording, and its error.

    The other oscillations are fitted beside it: a stretch may hold less than a period of a slow
    one, and what that leaves would count as this one's amplitude. The noise of an amplitude is the
    same in every stretch, that of its logarithm is not: stretches count by their amplitudes.
    """
    middles, amplitudes = [], []
    for part in _stretches(t, frequency):
        # A pendulum swings faster as it swings less: each stretch has its own frequency.
        span = t[part][-1] - t[part][0]
        reach = min(ALIKE * frequency, np.pi / span)
        own = minimize_scalar(
            lambda w, part=part: _misfit(t[part], x[part], w, *others),
            bounds=(frequency - reach, frequency + reach),
            method="bounded",
        ).x
        basis = _basis(t[part], float(own), *others)
        wave = np.linalg.lstsq(basis, x[part], rcond=None)[0][1:3]
        middles.append(t[part].mean())
        amplitudes.append(np.sqrt((wave**2).sum()))
    if len(middles) <= STRAIGHT:
        return float(-np.polyfit(middles, np.log(amplitudes), 1)[0]), float("nan")
    line, spread = np.polyfit(middles, np.log(amplitudes), 1, w=amplitudes, cov=True)
    return float(-line[0]), float(np.sqrt(spread[0, 0]))


def _without(t: np.ndarray, x: np.ndarray, frequency: float) -> np.ndarray:
    """What is left when one oscillation is taken out, stretch by stretch."""
    left = x.copy()
    for part in _stretches(t, frequency):
        basis = _basis(t[part], frequency)
        left[part] = x[part] - basis @ np.linalg.lstsq(basis, x[part], rcond=None)[0]
    return left
