"""What the best model's residual says of the measurement: single frames that are wrong, and colour.

The first fit takes the noise to be white and every frame to be true. Where its residual says
otherwise, false finds that no neighbouring frame gave away become gaps, the noise gets its memory,
and the terms are looked for again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vidphys.coupling_verdict import PowerVerdict
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.refine import refine
from vidphys.diagnose.recordings.colour import Colour
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.noise import borne_out, measure_noise
from vidphys.diagnose.weak.colour import BELIEVED, colour_of
from vidphys.diagnose.weak.paths import smooth
from vidphys.diagnose.weak.windows import Windows, cut_windows

FRAMES = (16, 24)  # of a window, at least and at most: several memories, and few swings
BESIDE_KICKS = 40.0  # gain of log likelihood by a memory, where kicks explain it nearly as well
SUPPOSED = (0.85, 0.6)  # correlations from frame to frame
LOOKS = 2  # at the residual, for what it says of the measurement
WITHOUT_RIVAL = 4.0  # and where nothing explains the motion without one
FAR, BESIDE = 8.0, 3.0  # usual residuals: of a frame that is wrong, and of its neighbours


@dataclass(frozen=True)
class Settled:
    """A motion as it was measured, and what follows from it.

    Args:
        motion: without what its residual shows to be wrong, and with its noise's colour.
        inference: of its terms.
        power: which powers of the coupling are possible, where couplings are known.
    """

    motion: Motion
    inference: Inference
    power: PowerVerdict | None


def settled(
    motion: Motion, infer: Callable[[Motion], tuple[Inference, PowerVerdict | None]]
) -> Settled:
    """Find the terms, look what they leave, and find them again where that tells something.

    Where nothing explains the motion, noise with a memory may hide behind wrong terms: one is
    supposed, and believed if terms that then explain all leave noise that has it. It is not where a
    force off the menu is certain: no noise looks like one.
    """
    found = _looked_at(motion, infer)
    rest = found.inference.leftover
    if rest.explained or rest.certain or found.motion.colour is not None:
        return found
    for correlation in SUPPOSED:
        other = _looked_at(_supposed(motion, correlation), infer)
        told = other.inference
        if told.leftover.explained and not told.kicks and _residual_colour(other) is not None:
            return other
    return found


def _looked_at(
    motion: Motion, infer: Callable[[Motion], tuple[Inference, PowerVerdict | None]]
) -> Settled:
    inference, power = infer(motion)
    for _ in range(LOOKS):
        seen = None if inference.stands and not inference.kicks else remeasured(motion, inference)
        if seen is None:
            break
        motion = seen
        inference, power = infer(motion)
    return Settled(motion, inference, power)


def _supposed(motion: Motion, correlation: float) -> Motion:
    """With noise that is so correlated from frame to frame, and in differences what it is."""
    noise = measure_noise(motion)
    unit = Colour(1.0, -motion.interval / np.log(correlation))
    shown = unit.in_differences(noise.order, motion.interval)
    return replace(motion, colour=Colour(noise.sigma / shown, unit.memory))


def _residual_colour(found: Settled) -> Colour | None:
    residual = _residual(found.motion, found.inference)
    return None if residual is None else _colour(found.motion, *residual, WITHOUT_RIVAL)


def _colour(
    motion: Motion, windows: Windows, residual: np.ndarray, believed: float = BELIEVED
) -> Colour | None:
    """The memory of the noise, if what is left has one and the frames bear it out."""
    colour = colour_of(windows, residual, believed)
    return colour if colour is not None and borne_out(colour, motion) else None


def _residual(motion: Motion, inference: Inference) -> tuple[Windows, np.ndarray] | None:
    """What the terms leave in windows of a few swings; ``None`` where they cannot be fitted."""
    size = int(np.clip(inference.windows.frames.shape[1], *FRAMES))
    size = min(size, motion.positions.shape[1])
    windows = cut_windows(motion, size, inference.windows.fine)
    try:
        fitted = refine(windows, smooth(windows, inference.noise.sigma), inference.structure)
    except (FloatingPointError, np.linalg.LinAlgError):
        return None
    return windows, fitted.residual


def remeasured(motion: Motion, inference: Inference) -> Motion | None:
    """The motion as its residual shows that it was measured; ``None`` where nothing is new.

    Args:
        motion: tracks.
        inference: of them.
    """
    left = _residual(motion, inference)
    if left is None:
        return None
    windows, residual = left
    wrong = _spikes(windows, residual)
    if wrong.any():
        positions = motion.positions.copy()
        window, frame, body = np.nonzero(wrong)
        positions[windows.clip[window], windows.first[window] + frame, body] = np.nan
        return replace(motion, positions=positions)
    colour = _colour(motion, windows, residual, BESIDE_KICKS if inference.kicks else BELIEVED)
    known = colour is None or (motion.colour is not None and motion.colour.near(colour))
    return None if known else replace(motion, colour=colour)


def _spikes(windows: Windows, residual: np.ndarray) -> np.ndarray:
    """Frames ``(w, f, n)`` far off between neighbours that are not."""
    off = np.where(windows.seen, np.linalg.norm(residual, axis=-1), np.nan)
    usual = np.nanmedian(off)
    beside = np.full((2, *off.shape), np.nan)
    beside[0, :, 1:], beside[1, :, :-1] = off[:, :-1], off[:, 1:]
    far = np.nan_to_num(off) > FAR * usual
    return far & (np.nan_to_num(beside).max(0) < np.maximum(BESIDE * usual, off / FAR * BESIDE))
