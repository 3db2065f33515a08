"""Masses of bodies that answer differently to each other: only their ratios can show in motion."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.measured import Settled
from vidphys.diagnose.inference.menu import PAIR, POWERS
from vidphys.diagnose.inference.refine import refine
from vidphys.diagnose.inference.structures import Structure
from vidphys.diagnose.recordings.balance import about_a_heavy_one, masses_in_balance
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.weak.paths import smooth
from vidphys.diagnose.weak.windows import cut_windows

FEW = 3  # bodies, up to which each one's mass is looked for
SWEEPS = 2
FARTHEST, BELIEVED, MOST = 10.0, 30.0, 1e3  # ratios of masses: tried first; told; tried at all
ROUGH = np.linspace(-np.log(FARTHEST), np.log(FARTHEST), 7)  # logarithms of a ratio
FRAMES = (12, 24)  # of the windows in which masses are tried
STEP = float(ROUGH[1] - ROUGH[0])
ENOUGH = {"xatol": 0.01, "fatol": 0.5, "maxfev": 80}  # of a logarithm, and of log likelihood
CLOSELY = {"xatol": 1e-4}  # of a logarithm
LOST = 1e30  # left under masses with which nothing fits; finite, as the search subtracts it
UNLIKE = 1.5  # ratio of masses in balance, from which alike ones are not asked
KEPT = {"pair", "contact", "uniform"}  # kinds that keep a balance of the masses
HELPS = 3.0  # gain of log likelihood by each mass, from which to go on


def weigh(
    motion: Motion,
    inference: Inference,
    infer: Callable[[Motion], Settled],
    ranked: Callable[[Motion, int], Sequence[Structure]],
) -> Settled | None:
    """Masses under which the menu explains the motion, of mean one in the logarithm, if any do.

    Bodies that are alike may explain by chance what others do with fewer numbers, the masses among
    them; those are told then.

    Args:
        motion: of two or three bodies whose masses are not known.
        inference: with all masses alike.
        infer: finds the terms once masses are set.
        ranked: every combination of terms in windows of so many frames, best first.
    """
    most = np.inf  # numbers of an answer, the masses among them
    if inference.leftover.explained:
        most = inference.structure.numbers - 1
    if not _unknown(motion) or not inference.structure.terms or most < motion.bodies:
        return None

    def takes(found: Settled) -> bool:
        numbers = found.inference.structure.numbers + motion.bodies - 1
        return found.inference.leftover.explained and numbers <= most

    balance = masses_in_balance(motion)
    if balance is not None:
        found = infer(_with(motion, np.log(balance)))
        if takes(found) and found.inference.kinds <= KEPT:
            return found  # their centre tells masses more closely than what acts between them
    likeliest = _likeliest(motion, inference, ranked)
    if likeliest is None:
        return None
    logs, structure = likeliest
    found = infer(_with(motion, logs))
    for _ in range(SWEEPS):
        # In long windows terms make up for masses that are slightly wrong: those of short ones do
        # not, so they come first.
        for body in range(1, motion.bodies):
            logs[body] = _near(found, structure, logs, body)
        # Under wrong masses terms stand for others, or for what is wrong with the masses.
        nearer = infer(_with(motion, logs))
        for each in (nearer, found):
            if takes(each):
                return each
        found, structure = nearer, nearer.inference.structure
    return None


def in_balance(motion: Motion, infer: Callable[[Motion], Settled]) -> Settled | None:
    """Masses that are clearly not alike by what their centre does, if a power of the distance
    explains the rest: bodies that springs hold to one place keep balances too.

    Where one body hardly moves, nothing but what acts between them may be told: a weight on a
    string, which is seen to hang from a nail, would be pulled by the nail.

    Args:
        motion: of bodies whose masses are not known.
        infer: finds the terms once masses are set.
    """
    if motion.bodies < 2 or not np.allclose(motion.mass, 1.0):
        return None
    balance = masses_in_balance(motion)
    if balance is not None:
        return _by_a_power(motion, balance, infer, KEPT) if _unlike(balance) else None
    heavy = about_a_heavy_one(motion)
    return None if heavy is None else _by_a_power(motion, heavy, infer, {PAIR})


def _by_a_power(
    motion: Motion, mass: np.ndarray, infer: Callable[[Motion], Settled], kinds: Collection[str]
) -> Settled | None:
    """What a power of the distance explains under these masses, beside terms of these kinds."""
    found = infer(_with(motion, np.log(mass)))
    told, pair = found.inference, found.inference.structure.term(PAIR)
    falls_off = pair is not None and pair.shape in POWERS
    return found if falls_off and told.leftover.explained and told.kinds <= set(kinds) else None


def _unknown(motion: Motion) -> bool:
    return bool(np.allclose(motion.mass, 1.0)) and 2 <= motion.bodies <= FEW


def _unlike(mass: np.ndarray) -> bool:
    return bool(mass.max() > UNLIKE * mass.min())


def _likeliest(
    motion: Motion, inference: Inference, ranked: Callable[[Motion, int], Sequence[Structure]]
) -> tuple[np.ndarray, Structure] | None:
    """Logarithms of the masses under which some terms are likeliest; ``None`` if all are alike."""
    size = int(np.clip(inference.windows.frames.shape[1], *FRAMES))

    def best(rest: Sequence[float] | np.ndarray) -> Structure:
        return ranked(_with(motion, np.array([0.0, *rest])), size)[0]

    def score(rest: Sequence[float] | np.ndarray) -> float:
        return best(rest).score

    rough = np.array(max(product(ROUGH, repeat=motion.bodies - 1), key=score))
    if inference.leftover.explained and not rough.any():
        return None
    simplex = rough + STEP / 2 * np.vstack([np.zeros(len(rough)), np.eye(len(rough))])
    found = minimize(
        lambda rest: -score(rest),
        rough,
        method="Nelder-Mead",
        bounds=[(-np.log(MOST), np.log(MOST))] * len(rough),
        options={"initial_simplex": simplex, **ENOUGH},
    )
    gain = -found.fun - score(np.zeros(len(rough)))
    if gain <= HELPS * len(rough):
        return None
    return np.array([0.0, *found.x]), best(found.x)


def _with(motion: Motion, logs: np.ndarray) -> Motion:
    mass = np.exp(logs - logs.mean())
    return replace(motion, mass=np.tile(mass, (motion.clips, 1)))


def _near(found: Settled, structure: Structure, logs: np.ndarray, body: int) -> float:
    """The logarithm of one mass with which these terms leave least."""

    def left(log: float) -> float:
        trial = logs.copy()
        trial[body] = log
        return _residual(_with(found.motion, trial), found.inference, structure)

    about = logs[body] + STEP / 2 * np.array([-1, 1])
    bounds = np.clip(about, -np.log(MOST), np.log(MOST))
    return float(minimize_scalar(left, bounds=bounds, method="bounded", options=CLOSELY).x)


def _residual(motion: Motion, inference: Inference, structure: Structure) -> float:
    windows = cut_windows(motion, inference.windows.frames.shape[1], inference.windows.fine)
    paths = smooth(windows, inference.noise.sigma)
    try:
        return refine(windows, paths, structure).variance
    except (FloatingPointError, np.linalg.LinAlgError):
        return LOST
