"""How noisy the positions are, and what can be seen above that noise at this frame rate."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from vidphys.diagnose.recordings.colour import Colour
from vidphys.diagnose.recordings.evened import evened
from vidphys.diagnose.recordings.motion import Motion, Unseen
from vidphys.statistics import ROBUST

ORDERS = range(3, 8)
FEWEST = 5  # differences of the lowest order, as of eight frames of one coordinate
SEEN = 3.0  # times its own noise, from which a speed counts as visible in one frame interval
SHORT = 1.25  # times the usual difference of frames, that differences of noise may be, by chance
EVEN = 0.1  # share by which frame intervals may differ for differences across them


@dataclass(frozen=True)
class Noise:
    """Noise of the positions, and how it compares with what moves.

    Args:
        sigma: standard deviation of one coordinate, world units.
        order: of the differences that it was read from.
        step: median distance that a body moves from frame to frame, world units.
        momentum_visible: whether a central difference shows a usual speed above its noise.
    """

    sigma: float
    order: int
    step: float
    momentum_visible: bool


def blur_seen(step: float, space: int) -> float:
    """Noise of a coordinate up to which a central difference shows speeds; see :class:`Noise`."""
    return step / (SEEN * _blurred(space))


def _blurred(space: int) -> float:
    """Noise of one step by a central difference over two intervals, over that of a coordinate."""
    return float(np.sqrt(2 * space) / 2)


def differences(motion: Motion, order: int) -> np.ndarray:
    """Differences over neighbouring frames that are evenly spaced, flattened, without gaps."""
    x = np.diff(motion.positions, order, axis=1)
    gaps = np.diff(motion.times, axis=1)
    even = np.abs(gaps - motion.interval) < EVEN * motion.interval
    windows = np.lib.stride_tricks.sliding_window_view(even, order, axis=1).all(-1)
    x = x[windows]
    return x[np.isfinite(x)]


def measure_noise(motion: Motion) -> Noise:
    """Noise from differences of the lowest order beyond which they shrink no further.

    A difference of order k of smooth motion shrinks with the frame interval to the power k, that
    of independent noise of variance s^2 has the variance s^2 binomial(2k, k). Noise of a known
    colour is that.

    Raises:
        Unseen: too few frames in a row show a body.
    """
    if motion.colour is not None:
        return noise_of(motion.colour.sigma, motion)
    best = _least(motion) or _least(evened(motion))
    if best is None:
        raise Unseen(
            f"no body is seen in {ORDERS[0] + 1} evenly spaced frames in a row, often enough to "
            "tell its motion from noise; follow fewer bodies, or use another part of the recording"
        )
    sigma, order = best
    return noise_of(sigma, motion, order)


def _least(motion: Motion) -> tuple[float, int] | None:
    """The least noise that differences of any order leave, and that order, if enough are there."""
    best = None
    for order in ORDERS:
        x = differences(motion, order)
        if len(x) < (2 * order if best else FEWEST):
            break
        sigma = float(np.sqrt(np.mean(x**2) / comb(2 * order, order)))
        if best is None or sigma < best[0]:
            best = (sigma, order)
    return best


def borne_out(colour: Colour, motion: Motion) -> bool:
    """Whether the frames show noise of this size and memory.

    Noise is in every frame, and motion only adds to differences of frames: where half of them are
    smaller than such noise would leave them, it is none.
    """
    for order in ORDERS:
        x = differences(motion, order)
        if len(x) < 2 * order:
            break
        usual = ROBUST * float(np.median(np.abs(x)) / np.sqrt(comb(2 * order, order)))
        # Places that are counted in pixels may not change at all.
        if 0 < SHORT * usual < colour.sigma * colour.in_differences(order, motion.interval):
            return False
    return True


def noise_of(sigma: float, motion: Motion, order: int = 0) -> Noise:
    """Noise of a size that is known, beside what moves; ``order`` 0: not by differences."""
    steps = np.linalg.norm(np.diff(motion.positions, axis=1), axis=-1)
    step = float(np.nanmedian(steps))
    return Noise(sigma, order, step, bool(sigma < blur_seen(step, motion.space)))
