"""X1-X5: the friction rate from the balance of energy, when the law of the forces is known.

The study regresses the change of E = K + V over a window on the energy that friction would take.
Both sides are read from central differences of noisy positions, which adds the variance of the
noise to K and pulls the rate towards zero (its ``plain`` form). The ``corrected`` form subtracts
that variance, leaves friction's share of the energy integrated instead of averaged, and joins all
windows in one ratio, whose denominator noise no longer inflates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.motion import Motion
from vidphys.diagnose.noise import measure_noise

Potential = Callable[[np.ndarray], np.ndarray]
WINDOW = 6  # intervals (inventory 12.36)
RESAMPLES = 400


@dataclass(frozen=True)
class Rate:
    """A friction rate, per second, of dp/dt = -rate v.

    Args:
        value: median over clips (plain) or the ratio over all of them (corrected).
        low, high: 95 % of bootstrap resamples of whole clips.
        clips: of each clip alone, ``(e,)``.
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
    """The study's estimator (X1): least squares through the origin of each clip, their median."""
    found = balance(motion, potential, window)
    clips = (found.lost * found.spent).sum(1) / (found.spent**2).sum(1)
    return _with_interval(clips, np.ones_like(clips), np.median)


def corrected_rate(motion: Motion, potential: Potential, sigma: float | None = None) -> Rate:
    """The same without attenuation: noise is subtracted, and all windows join in one ratio.

    A ratio of sums has no squared noise in its denominator, as least squares has. Positions enter
    V as they are: its own curvature times the variance of the noise cancels between the ends.

    Args:
        motion: see :func:`balance`.
        potential: see :func:`balance`.
        sigma: of the noise; measured where not given.
    """
    noise = measure_noise(motion).sigma if sigma is None else sigma
    longest = motion.positions.shape[1] - 3
    # Over the whole clip and in between: few long windows lose least to the noise of their ends.
    found = balance(motion, potential, max(WINDOW, longest // 2), noise)
    lost, spent = found.lost.mean(1), found.spent.mean(1)
    return _with_interval(lost, spent, None)


def _with_interval(
    top: np.ndarray, bottom: np.ndarray, join: Callable[[np.ndarray], float] | None
) -> Rate:
    """Joined over clips, with a bootstrap over whole clips."""

    def value(chosen: np.ndarray) -> float:
        if join is not None:
            return float(join(top[chosen] / bottom[chosen]))
        return float(top[chosen].sum() / bottom[chosen].sum())

    rng = np.random.default_rng(0)
    everything = np.arange(len(top))
    drawn = [value(rng.integers(len(top), size=len(top))) for _ in range(RESAMPLES)]
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Rate(value(everything), float(low), float(high), top / bottom)


def sliding_rates(
    motion: Motion, potential: Potential, window: int = WINDOW, sigma: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """X3: times and rates ``(windows,)`` of windows that slide along, joined over clips."""
    found = balance(motion, potential, window, sigma)
    return found.begin, found.lost.sum(0) / found.spent.sum(0)


def envelope_rate(motion: Motion) -> float:
    """X5, the form that fails: the decay of the kinetic energy alone, which infall reverses."""
    h = motion.interval
    v = (motion.positions[:, 2:] - motion.positions[:, :-2]) / (2 * h)
    kinetic = 0.5 * (motion.mass[:, None] * (v**2).sum(-1)).sum(-1).mean(0)
    times = np.arange(len(kinetic)) * h
    return float(-0.5 * np.polyfit(times, np.log(kinetic), 1)[0])
