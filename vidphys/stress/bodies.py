"""The systems that cells are made of: two bodies on an orbit, a contact, and what they conserve."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dynamics import INTEGRATORS, Hamiltonian, Parameters, PhaseState, rollout
from dynamics.checks import energy_drift
from dynamics.contact import SoftContact
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity

DTYPES = {"float64": torch.float64, "float32": torch.float32}
STEP = 0.002  # seconds, the study's


@dataclass(frozen=True)
class Orbit:
    """Two bodies that start at apocentre, in units of their distance there.

    Args:
        eccentricity: of the orbit without softening; 0 is a circle, 1 falls.
        softening: world units.
        masses: of the two.
        scale: world units of the distance; G grows with its cube, so that times stay.
        total: G times the masses' sum at scale 1; the circular period is 2 pi / sqrt(total).
    """

    eccentricity: float
    softening: float
    masses: tuple[float, float] = (1.0, 1.0)
    scale: float = 1.0
    total: float = 2.0

    def start(self, dtype: torch.dtype, episodes: int = 0) -> tuple[PhaseState, Parameters]:
        """The state and its law; ``episodes`` turned copies where more than none are asked for."""
        m = torch.tensor(self.masses, dtype=torch.float64)
        along, across = torch.tensor([1.0, 0]).double(), torch.tensor([0.0, 1]).double()
        speed = math.sqrt(self.total * (1 - self.eccentricity))
        share = torch.stack([m[1], -m[0]]) / m.sum()
        q = self.scale * share.unsqueeze(-1) * along
        p = self.scale * speed * m.prod() / m.sum() * torch.stack([across, -across])
        coupling = (self.total * self.scale**3 / m.sum()).clone()
        state, params = PhaseState(q, p), Parameters(coupling, m)
        if episodes:
            angle = 2 * math.pi * torch.arange(episodes).double() / episodes
            turn = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()], -1)
            turn = turn.reshape(episodes, 1, 2, 2)
            state = state.map(lambda x: (turn @ x.unsqueeze(-1)).squeeze(-1))
            params = Parameters(coupling.expand(episodes), m.expand(episodes, 2))
        return state.map(lambda x: x.to(dtype)), params.map(lambda x: x.to(dtype))

    def law(self, integrator: str) -> Hamiltonian:
        """The exact law, stepped by a method."""
        potential = SoftenedGravity(self.softening * self.scale)
        return Hamiltonian(FixedKinetic(), potential, INTEGRATORS[integrator])


def contact_law(diameter: float, integrator: str) -> Hamiltonian:
    """Two disks that push each other apart."""
    return Hamiltonian(FixedKinetic(), SoftContact(diameter), INTEGRATORS[integrator])


def colliding(dtype: torch.dtype, stiffness: float, offset: float) -> tuple[PhaseState, Parameters]:
    """Two unit masses that fly at each other at unit speed, ``offset`` off the line."""
    q = torch.tensor([[-0.4, 0.0], [0.4, offset]], dtype=dtype)
    p = torch.tensor([[1.0, 0.0], [-1.0, 0.0]], dtype=dtype)
    return PhaseState(q, p), Parameters(
        torch.tensor(stiffness, dtype=dtype), torch.ones(2).to(dtype)
    )


def invariant_error(
    head: Hamiltonian,
    start: PhaseState,
    params: Parameters,
    steps: int,
    dt: float = STEP,
    every: int = 1,
    substeps: bool = True,
) -> float:
    """Largest change of energy, and of angular momentum over its scale, in float64, of a rollout.

    Angular momentum is relative to the largest sum of |q| |p| on the way.
    """
    run = rollout(head, start, params, steps, dt, every, substeps=substeps)
    states, law = run.states.map(torch.Tensor.double), params.map(torch.Tensor.double)
    energy = energy_drift(head, states, law).max()
    turning = angular_momentum(states)
    size = (states.q.norm(dim=-1) * states.p.norm(dim=-1)).sum(-1).amax(-1, keepdim=True)
    turned = ((turning - turning[..., :1]).abs() / size).max()
    return float(torch.stack([energy, turned]).max())  # max hands a NaN on


def angular_momentum(states: PhaseState) -> Tensor:
    """Sum of x p_y - y p_x over bodies."""
    q, p = states.q, states.p
    return (q[..., 0] * p[..., 1] - q[..., 1] * p[..., 0]).sum(-1)
