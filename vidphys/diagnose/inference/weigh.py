"""Masses of bodies that answer differently to each other: only their ratios can show in motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import minimize_scalar

from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.refine import refine
from vidphys.diagnose.inference.structures import Structure
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.weak.paths import smooth
from vidphys.diagnose.weak.windows import cut_windows

FEW = 3  # bodies, up to which each one's mass is looked for
SWEEPS = 3
FARTHEST = 10.0  # ratio of two masses
ROUGH = np.linspace(-np.log(FARTHEST), np.log(FARTHEST), 7)  # logarithms of a ratio
FRAMES = (12, 24)  # of the windows in which masses are tried
HELPS = 0.8  # of the residual with equal masses, to which other masses must bring it to go on


@dataclass(frozen=True)
class Weighed:
    """The motion with masses, of mean one in the logarithm, and what follows for the terms."""

    motion: Motion
    inference: Inference


def weigh(
    motion: Motion,
    inference: Inference,
    infer: Callable[[Motion], Inference],
    ranked: Callable[[Motion, int], Sequence[Structure]],
) -> Weighed | None:
    """Masses under which the menu explains the motion, if there are any.

    Args:
        motion: of two or three bodies whose masses are not known.
        inference: with all masses alike, which left something unexplained.
        infer: finds the terms once masses are set.
        ranked: every combination of terms in windows of so many frames, best first.
    """
    unknown = np.allclose(motion.mass, 1.0) and 2 <= motion.bodies <= FEW
    if not unknown or inference.leftover.explained or not inference.structure.terms:
        return None
    size = int(np.clip(inference.windows.frames.shape[1], *FRAMES))
    most = HELPS * ranked(motion, size)[0].misfit
    tried = [np.array([0.0, *rest]) for rest in product(ROUGH, repeat=motion.bodies - 1)]
    found = [(ranked(_with(motion, logs), size)[0], logs) for logs in tried]
    best, logs = max(found, key=lambda one: one[0].score)
    if not best.misfit < most:
        return None
    inference = replace(inference, fitted=replace(inference.fitted, structure=best))
    for _ in range(SWEEPS):
        for body in range(1, motion.bodies):
            logs[body] = _near(motion, inference, logs, body)
        weighed = _with(motion, logs)
        # Nearer masses may show terms that stood for others under wrong ones.
        inference = infer(weighed)
        if inference.leftover.explained:
            return Weighed(weighed, inference)
    return None


def _with(motion: Motion, logs: np.ndarray) -> Motion:
    mass = np.exp(logs - logs.mean())
    return replace(motion, mass=np.tile(mass, (motion.clips, 1)))


def _left(motion: Motion, inference: Inference, logs: np.ndarray, body: int, log: float) -> float:
    """What the same terms leave if the logarithm of one mass is this."""
    trial = logs.copy()
    trial[body] = log
    return _residual(_with(motion, trial), inference)


def _near(motion: Motion, inference: Inference, logs: np.ndarray, body: int) -> float:
    """The same between the neighbours of what was found so far."""
    step = float(ROUGH[1] - ROUGH[0])
    bounds = (logs[body] - step, logs[body] + step)
    found = minimize_scalar(
        lambda log: _left(motion, inference, logs, body, float(log)),
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(found.x)


def _residual(motion: Motion, inference: Inference) -> float:
    windows = cut_windows(motion, inference.windows.frames.shape[1])
    paths = smooth(windows, inference.noise.sigma)
    try:
        return refine(windows, paths, inference.structure).variance
    except (FloatingPointError, np.linalg.LinAlgError):
        return np.inf
