"""What a compiled model and the network behind it are both asked: starts, laws and steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynamics import Parameters, PhaseState
from vidphys.stress.bodies import STEP, Orbit

SOFTENING = 0.1  # world units, of the law that the networks are fitted to
STEPS = 450  # past the closest approach of all shapes


@dataclass(frozen=True)
class Question:
    """What a compiled model and its network are both asked.

    Args:
        start, params: in float64.
        steps: of a rollout.
        dt: seconds.
    """

    start: PhaseState
    params: Parameters
    steps: int = STEPS
    dt: float = STEP


def orbit(
    eccentricity: float,
    coupling: float,
    mass: float = 1.0,
    dt: float = STEP,
    steps: int = STEPS,
) -> Question:
    """Two bodies from apocentre, with masses 1 and ``mass``; for no more than four seconds."""
    start, params = Orbit(eccentricity, SOFTENING, (1.0, mass)).start(torch.float64)
    law = params.with_coupling(coupling * float(params.coupling))
    return Question(start, law, min(steps, round(4 / dt)), dt)


def at_rest() -> Question:
    """One step from rest, at distances of training; float32 holds the positions exactly."""
    rng = torch.Generator().manual_seed(0)
    corners = torch.tensor([[0.5, 0.0], [-0.25, 0.4], [-0.25, -0.4]], dtype=torch.float64)
    q = corners + 0.1 * torch.rand(64, 3, 2, generator=rng, dtype=torch.float64)
    q = q.float().double()
    params = Parameters(torch.ones(64), torch.ones(64, 3)).map(Tensor.double)
    return Question(PhaseState(q, torch.zeros_like(q)), params, 1)


def spread(factor: float) -> Question:
    """Distances as many times as large, at the orbit's own speeds."""
    asked = orbit(0.0, 1.0)
    return replace(asked, start=PhaseState(factor * asked.start.q, asked.start.p), steps=20)


def shifted(shift: float) -> Question:
    """A circle, so many world units from the origin."""
    asked = orbit(0.0, 1.0)
    return replace(asked, start=PhaseState(asked.start.q + shift, asked.start.p), steps=20)


def crowd(count: int) -> Question:
    """Bodies at random, about as dense however many they are."""
    rng = torch.Generator().manual_seed(count)
    q, p = torch.randn(2, count, 2, generator=rng, dtype=torch.float64)
    params = Parameters(torch.ones(()), torch.ones(count)).map(Tensor.double)
    return Question(PhaseState(max(1, count) ** 0.5 * q, 0.1 * p), params, 20)


def spoiled(field: str, value: float) -> Question:
    """A circle with one number of its state or law put wrong."""
    asked = orbit(0.0, 1.0)
    parts = {"q": asked.start.q, "p": asked.start.p}
    parts |= {"coupling": asked.params.coupling, "mass": asked.params.mass}
    parts[field] = parts[field].clone()
    parts[field].view(-1)[-1] = value
    law = Parameters(parts["coupling"], parts["mass"])
    return replace(asked, start=PhaseState(parts["q"], parts["p"]), params=law)
