"""The friction rate from the balance of energy, when the law of the forces is known.

The study regresses the change of E = K + V over a window on the energy that friction would take.
Both sides are read from central differences of noisy positions, which adds the variance of the
noise to K and pulls the rate towards zero (its ``plain`` form). The ``corrected`` form subtracts
that variance, leaves friction's share of the energy integrated instead of averaged, and joins all
windows in one ratio, whose denominator noise no longer inflates. What is left is the error of the
differences themselves, which four times as large a one, from every second frame, gives away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.noise import measure_noise

Potential = Callable[[np.ndarray], np.ndarray]
WINDOW = 6  # intervals
RESAMPLES = 400


@dataclass(frozen=True)
class Rate:
    """A friction rate, per second, of dp/dt = -rate v.

    Args:
        value: median over clips (plain) or the ratio over all of them (corrected).
        low, high: 95 % of bootstrap resamples of whole clips; of the corrected one also what the
            frame rate leaves open.
        clips: of each clip alone, ``(e,)``, as the frames are.
    """

    value: float
    low: float
    high: float
    clips: np.ndarray

    @property
    def carried(self) -> float:
        """What a port that can only take energy is given: never less than zero."""
        return max(self.value, 0.0)


@dataclass(frozen=True)
class Balance:
    """Both sides of the energy balance.

    Args:
        lost: energy lost over each window, ``(e, windows)``.
        spent: what friction of unit rate would have taken, ``(e, windows)``.
        begin: seconds, ``(windows,)``, of the middle of each.
    """

    lost: np.ndarray
    spent: np.ndarray
    begin: np.ndarray


def balance(
    motion: Motion, potential: Potential, window: int = WINDOW, sigma: float = 0.0
) -> Balance:
    """Energy lost, and friction's share of it, over every window of every clip.

    Args:
        motion: evenly spaced frames, every body seen in each.
        potential: V of places ``(e, t, n, d)``, joules, ``(e, t)``.
        window: intervals of each window; windows overlap.
        sigma: noise that is subtracted from the kinetic energy, world units.

    Raises:
        ValueError: clips of fewer than ``window + 3`` frames.
    """
    frames = motion.positions.shape[1]
    if frames < window + 3:
        raise ValueError(f"balance: needs {window + 3} frames or more, got {frames}")
    h = motion.interval
    v = (motion.positions[:, 2:] - motion.positions[:, :-2]) / (2 * h)
    blur = motion.space * sigma**2 / (2 * h**2)  # of |v|^2 of one body
    speed2 = (v**2).sum(-1) - blur
    kinetic = 0.5 * (motion.mass[:, None] * speed2).sum(-1)
    energy = kinetic + potential(motion.positions[:, 1:-1])
    power = speed2.sum(-1)
    lost = energy[:, :-window] - energy[:, window:]
    steps = 0.5 * h * (power[:, 1:] + power[:, :-1])
    summed = np.concatenate([np.zeros_like(steps[:, :1]), steps.cumsum(1)], 1)
    spent = summed[:, window:] - summed[:, :-window]
    middle = motion.times[0, 1:-1][: lost.shape[1]] + window * h / 2
    return Balance(lost, spent, middle)


def plain_rate(motion: Motion, potential: Potential, window: int = WINDOW) -> Rate:
    """The study's estimator: least squares through the origin of each clip, their median."""
    found = balance(motion, potential, window)
    clips = (found.lost * found.spent).sum(1) / (found.spent**2).sum(1)
    return _with_interval(lambda chosen: float(np.median(clips[chosen])), clips)


def corrected_rate(motion: Motion, potential: Potential, sigma: float | None = None) -> Rate:
    """The same without attenuation: noise is subtracted, and all windows join in one ratio.

    A ratio of sums has no squared noise in its denominator, as least squares has. Positions enter
    V as they are: its own curvature times the variance of the noise cancels between the ends.
    Clips of eighteen frames or more are also read at half the frame rate: a central difference is
    wrong by the square of its step, so that a third of the change is the error, and is taken off.

    Args:
        motion: see :func:`balance`.
        potential: see :func:`balance`.
        sigma: of the noise; measured where not given.
    """
    noise = measure_noise(motion).sigma if sigma is None else sigma
    fine = _ratio(motion, potential, noise)
    if motion.positions.shape[1] < 2 * (WINDOW + 3):
        return _with_interval(lambda chosen: _joined(fine[:, chosen]), fine[0] / fine[1])
    halves = (_ratio(_every_second(motion, first), potential, noise) for first in (0, 1))
    coarse = sum(halves, np.zeros_like(fine))

    def extrapolated(chosen: np.ndarray) -> float:
        here, there = _joined(fine[:, chosen]), _joined(coarse[:, chosen])
        return here - (there - here) / 3

    rate = _with_interval(extrapolated, fine[0] / fine[1])
    # What the correction leaves is taken to be as much smaller than the change as the change is
    # smaller than the rate: nothing where frames resolve the motion, all where they do not.
    change = abs(_joined(coarse) - _joined(fine))
    left = change * min(1.0, change / max(abs(rate.value), np.finfo(float).tiny))
    return replace(rate, low=rate.low - left, high=rate.high + left)


def _ratio(motion: Motion, potential: Potential, noise: float) -> np.ndarray:
    """Energy lost and what unit friction would have taken, of each clip, ``(2, e)``."""
    longest = motion.positions.shape[1] - 3
    # Over the whole clip and in between: few long windows lose least to the noise of their ends.
    found = balance(motion, potential, max(WINDOW, longest // 2), noise)
    return np.stack([found.lost.mean(1), found.spent.mean(1)])


def _joined(ratio: np.ndarray) -> float:
    lost, spent = ratio.sum(1)
    return float(lost / spent)


def _every_second(motion: Motion, first: int) -> Motion:
    frames = slice(first, None, 2)
    return replace(motion, positions=motion.positions[:, frames], times=motion.times[:, frames])


def _with_interval(value: Callable[[np.ndarray], float], clips: np.ndarray) -> Rate:
    """A value of chosen clips, of all of them, with a bootstrap over whole clips."""
    rng, count = np.random.default_rng(0), len(clips)
    drawn = [value(rng.integers(count, size=count)) for _ in range(RESAMPLES)]
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Rate(value(np.arange(count)), float(low), float(high), clips)


def sliding_rates(
    motion: Motion, potential: Potential, window: int = WINDOW, sigma: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times and rates ``(windows,)`` of windows that slide along, joined over clips."""
    found = balance(motion, potential, window, sigma)
    return found.begin, found.lost.sum(0) / found.spent.sum(0)


def envelope_rate(motion: Motion) -> float:
    """The form that fails: the decay of the kinetic energy alone, which infall reverses."""
    h = motion.interval
    v = (motion.positions[:, 2:] - motion.positions[:, :-2]) / (2 * h)
    kinetic = 0.5 * (motion.mass[:, None] * (v**2).sum(-1)).sum(-1).mean(0)
    times = np.arange(len(kinetic)) * h
    return float(-0.5 * np.polyfit(times, np.log(kinetic), 1)[0])
