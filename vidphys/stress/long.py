"""Rollouts of a million steps: bounded energy, and the law by which rounding grows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import torch
from torch import Tensor

from dynamics import rollout
from vidphys.stress.bodies import DTYPES, STEP, Orbit
from vidphys.stress.case import SOUND, Case

EPISODES = 128  # turned copies: their rounding differs, and its growth is an average
COARSE = 0.05  # seconds: long enough steps for rounding in the forces to show above the storage's
_DRIFTS: dict[tuple[str, str, int, float], tuple[Tensor, Tensor]] = {}


def long_rollouts(steps: int) -> Iterator[Case]:
    """A8 and A9: bounded energy in float64, and how rounding grows in float32.

    Args:
        steps: a million in the standard preset.
    """
    for name, dtype, bound in (
        ("leapfrog", "float64", 1e-6),
        ("leapfrog", "float32", 1e-3),
        ("leapfrog_compensated", "float32", 1e-3),
    ):
        run = partial(_long, name, dtype, steps)
        yield Case(
            "long rollout",
            "circular orbit",
            f"{steps:,} steps, energy",
            float(steps),
            run,
            bound,
            name,
            dtype,
            "batched",
            "A8",
            (SOUND,),
        )
    yield Case(
        "long rollout",
        "circular orbit",
        f"{steps:,} steps, last decade over first",
        float(steps),
        partial(_growth, "leapfrog", "float64", steps),
        1.5,
        "leapfrog",
        "float64",
        "batched",
        "A8",
        (SOUND,),
    )
    yield Case(
        "long rollout",
        "circular orbit",
        f"{steps:,} steps, exponent of the growth less a half",
        float(steps),
        partial(_exponent_off, "leapfrog_compensated", "float32", steps // 5),
        0.15,
        "leapfrog_compensated",
        "float32",
        "batched",
        "A9",
        (SOUND,),
    )
    yield Case(
        "long rollout",
        "circular orbit",
        f"{steps:,} steps, exponent of the growth outside 1/2 to 1",
        float(steps),
        partial(_grows_faster_than_time, "leapfrog", "float32", steps // 5),
        0.15,
        "leapfrog",
        "float32",
        "batched",
        "A8",
        (SOUND,),
    )


def _grows_faster_than_time(integrator: str, dtype: str, steps: int) -> float:
    """How far the exponent of rounding's growth lies outside [1/2, 1]."""
    found = exponent(integrator, dtype, steps)
    return max(0.5 - found, found - 1.0, 0.0)


def drifts(
    integrator: str, dtype: str, steps: int, dt: float = STEP, eccentricity: float = 0.05
) -> tuple[Tensor, Tensor]:
    """Steps, and the relative energy error there of each episode, ``(episodes, t)``; kept."""
    key = integrator, dtype, steps, dt
    if key not in _DRIFTS:
        orbit = Orbit(eccentricity, 0.1)
        start, params = orbit.start(DTYPES[dtype], EPISODES)
        every = max(1, steps // 1000)
        law = orbit.law(integrator)
        # Rounding is what is looked at here: both precisions take the same fixed steps.
        run = rollout(law, start, params, steps, dt, every, substeps=False)
        states = run.states.map(Tensor.double)
        energy = law.energy(states, params.map(lambda x: x.double().unsqueeze(1)))
        drift = energy / energy[:, :1] - 1
        _DRIFTS[key] = torch.arange(drift.shape[1]) * every, drift
    return _DRIFTS[key]


def _long(integrator: str, dtype: str, steps: int) -> float:
    return float(drifts(integrator, dtype, steps)[1].abs().max())


def _growth(integrator: str, dtype: str, steps: int) -> float:
    """Largest error in the last tenth over that in the first tenth of the time."""
    drift = drifts(integrator, dtype, steps)[1].abs()
    tenth = drift.shape[1] // 10
    return float(drift[:, -tenth:].max() / drift[:, 1 : tenth + 1].max())


def exponent(integrator: str, dtype: str, steps: int) -> float:
    """Exponent of rounding's growth: of the rms of the difference from float64, against time."""
    at, drift = drifts(integrator, dtype, steps, COARSE, 0.0)
    _, exact = drifts("leapfrog", "float64", steps, COARSE, 0.0)
    rounding = (drift - exact).square().mean(0).sqrt()
    blocks = torch.logspace(1.3, math.log10(len(at) - 1), 10).round().long().unique()
    ends = list(zip(blocks[:-1], blocks[1:], strict=True))
    size = torch.stack([rounding[a:b].square().mean().sqrt() for a, b in ends]).log()
    time = torch.stack([at[a:b].double().mean() for a, b in ends]).log()
    centred = time - time.mean()
    return float((size * centred).sum() / centred.square().sum())


def _exponent_off(integrator: str, dtype: str, steps: int) -> float:
    return abs(exponent(integrator, dtype, steps) - 0.5)
