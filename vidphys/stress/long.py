"""Rollouts of a million steps: bounded energy, and the law by which rounding grows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache, partial

import torch
from torch import Tensor

from dynamics import rollout
from vidphys.stress.bodies import DTYPES, STEP, Orbit
from vidphys.stress.case import SOUND, Case

EPISODES = 128  # turned copies: their rounding differs, and its growth is an average
COARSE = 0.05  # seconds: long enough steps for rounding in the forces to show above the storage's


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
        yield _case(steps, "energy", _long, name, dtype, steps, bound, "A8")
    what = "last decade over first"
    yield _case(steps, what, _growth, "leapfrog", "float64", steps, 1.5, "A8")
    fewer, name = steps // 5, "leapfrog_compensated"
    what = "exponent of the growth less a half"
    yield _case(steps, what, _exponent_off, name, "float32", fewer, 0.15, "A9")
    what = "exponent of the growth outside 1/2 to 1"
    yield _case(steps, what, _grows_faster_than_time, "leapfrog", "float32", fewer, 0.15, "A8")


def _case(
    steps: int,
    what: str,
    measure: Callable[[str, str, int], float],
    integrator: str,
    dtype: str,
    taken: int,
    bound: float,
    figure: str,
) -> Case:
    """A cell of the axis at ``steps``; what it measures is of a rollout of ``taken`` steps."""
    return Case(
        "long rollout",
        "circular orbit",
        f"{steps:,} steps, {what}",
        float(steps),
        partial(measure, integrator, dtype, taken),
        bound,
        integrator,
        dtype,
        "batched",
        figure,
        (SOUND,),
    )


def _grows_faster_than_time(integrator: str, dtype: str, steps: int) -> float:
    """How far the exponent of rounding's growth lies outside [1/2, 1]."""
    found = exponent(integrator, dtype, steps)
    return max(0.5 - found, found - 1.0, 0.0)


@cache
def drifts(
    integrator: str, dtype: str, steps: int, dt: float = STEP, eccentricity: float = 0.05
) -> tuple[Tensor, Tensor]:
    """Steps, and the relative energy error there of each episode, ``(episodes, t)``; kept."""
    orbit = Orbit(eccentricity, 0.1)
    start, params = orbit.start(DTYPES[dtype], EPISODES)
    every = max(1, steps // 1000)
    law = orbit.law(integrator)
    # Rounding is what is looked at here: both precisions take the same fixed steps.
    run = rollout(law, start, params, steps, dt, every, substeps=False)
    states = run.states.map(Tensor.double)
    energy = law.energy(states, params.map(lambda x: x.double().unsqueeze(1)))
    drift = energy / energy[:, :1] - 1
    return torch.arange(drift.shape[1]) * every, drift


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
