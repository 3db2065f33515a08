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
Drifts = Callable[..., tuple[Tensor, Tensor]]  # :func:`drifts`, that remembers
COARSE = 0.05  # seconds: long enough steps for rounding in the forces to show above the storage's


def long_rollouts(steps: int) -> Iterator[Case]:
    """A8 and A9: bounded energy in float64, and how rounding grows in float32.

    Args:
        steps: a million in the standard preset.
    """
    kept = cache(drifts)  # of these cells; several of them look at one rollout
    for name, dtype, bound in (
        ("leapfrog", "float64", 1e-6),
        ("leapfrog", "float32", 1e-3),
        ("leapfrog_compensated", "float32", 1e-3),
    ):
        yield _case(steps, "energy", partial(_long, kept), name, dtype, steps, bound, "A8")
    what = "last decade over first"
    yield _case(steps, what, partial(_growth, kept), "leapfrog", "float64", steps, 1.5, "A8")
    fewer, name = steps // 5, "leapfrog_compensated"
    what = "exponent of the growth less a half"
    yield _case(steps, what, partial(_exponent_off, kept), name, "float32", fewer, 0.15, "A9")
    what = "exponent of the growth outside 1/2 to 1"
    yield _case(
        steps,
        what,
        partial(_grows_faster_than_time, kept),
        "leapfrog",
        "float32",
        fewer,
        0.15,
        "A8",
    )


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
    cell = partial(Case, "long rollout", "circular orbit", path="batched", must=(SOUND,))
    run, extreme = partial(measure, integrator, dtype, taken), f"{steps:,} steps, {what}"
    return cell(extreme, float(steps), run, bound, integrator, dtype, figure=figure)


def _grows_faster_than_time(kept: Drifts, integrator: str, dtype: str, steps: int) -> float:
    """How far the exponent of rounding's growth lies outside [1/2, 1]."""
    found = exponent(kept, integrator, dtype, steps)
    return max(0.5 - found, found - 1.0, 0.0)


def drifts(
    integrator: str, dtype: str, steps: int, dt: float = STEP, eccentricity: float = 0.05
) -> tuple[Tensor, Tensor]:
    """Steps, and the relative energy error there of each episode, ``(episodes, t)``."""
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


def _long(kept: Drifts, integrator: str, dtype: str, steps: int) -> float:
    return float(kept(integrator, dtype, steps)[1].abs().max())


def _growth(kept: Drifts, integrator: str, dtype: str, steps: int) -> float:
    """Largest error in the last tenth over that in the first tenth of the time."""
    drift = kept(integrator, dtype, steps)[1].abs()
    tenth = drift.shape[1] // 10
    return float(drift[:, -tenth:].max() / drift[:, 1 : tenth + 1].max())


def exponent(kept: Drifts, integrator: str, dtype: str, steps: int) -> float:
    """Exponent of rounding's growth: of the rms of the difference from float64, against time."""
    at, drift = kept(integrator, dtype, steps, COARSE, 0.0)
    _, exact = kept("leapfrog", "float64", steps, COARSE, 0.0)
    rounding = (drift - exact).square().mean(0).sqrt()
    blocks = torch.logspace(1.3, math.log10(len(at) - 1), 10).round().long().unique()
    ends = list(zip(blocks[:-1], blocks[1:], strict=True))
    size = torch.stack([rounding[a:b].square().mean().sqrt() for a, b in ends]).log()
    time = torch.stack([at[a:b].double().mean() for a, b in ends]).log()
    centred = time - time.mean()
    return float((size * centred).sum() / centred.square().sum())


def _exponent_off(kept: Drifts, integrator: str, dtype: str, steps: int) -> float:
    return abs(exponent(kept, integrator, dtype, steps) - 0.5)
