"""One-step densities of stochastic heads: exact for a bath, Euler-Maruyama for a neural SDE."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.bath import Bath
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head
from dynamics.integrators import Memory, leapfrog
from dynamics.kinetic import FixedKinetic
from dynamics.mlp import MLP, SILU
from dynamics.state import Parameters, PhaseState


class NeuralSDE(Head):
    """dx = f(x, c) dt + g(x, c) dW, drift and diffusion learned, in Ito's sense
    (neural SDE, Li et al., AISTATS 2020).

    Nothing ties the two. Stepped by Euler and Maruyama.

    Args:
        bodies, space: sizes of the state.
        conditions: entries of the parameters' vector.
        width: of the two hidden layers.
        dt: seconds of the step that the sizes of increments will be told for.
    """

    scale: Tensor

    def __init__(self, bodies: int, space: int, conditions: int, width: int, dt: float) -> None:
        super().__init__()
        size = 2 * bodies * space
        self.told_for = dt
        self.network = MLP((size + conditions, width, width, 2 * size), SILU)
        self.register_buffer("scale", torch.ones(size))

    def set_scale(self, q: float, p: float) -> None:
        """Set the sizes of one step's increments, world units and momentum units."""
        half = len(self.scale) // 2
        self.scale = torch.tensor([q] * half + [p] * half).to(self.scale)

    def moments(self, state: PhaseState, params: Parameters, dt: float) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of one step's increment, flat, ``(..., 2 n d)`` each."""
        out = self.network(torch.cat([state.flat, params.flat], -1))
        drift, raw = out.chunk(2, -1)
        share = dt / self.told_for
        deviation = nn.functional.softplus(raw) + LEAST
        return share * self.scale * drift, share**0.5 * self.scale * deviation

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        mean, deviation = self.moments(state, params, dt)
        x = state.flat + mean + deviation * torch.randn_like(mean)
        return PhaseState.from_flat(x, state.q.shape[-2], state.q.shape[-1]), memory

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        """The drift of the momenta, ``(..., n, d)``."""
        drift = self.moments(state, params, self.told_for)[0] / self.told_for
        return PhaseState.from_flat(drift, state.q.shape[-2], state.q.shape[-1]).p

    def nll(self, start: PhaseState, step: PhaseState, params: Parameters, dt: float) -> Tensor:
        """Negative log density of one step's increments, up to a constant, ``(...)``."""
        mean, deviation = self.moments(start, params, dt)
        return (0.5 * ((step.flat - mean) / deviation).square() + deviation.log()).sum(-1)


LEAST = 1e-3  # of the increments' size: noise below this is not resolved


@dataclass(frozen=True)
class HalfSteps:
    """The momenta before and after the two half steps of a bath, ``(2, ..., n, d)`` each."""

    before: Tensor
    after: Tensor

    def nll(self, bath: Bath, params: Parameters, dt: float) -> Tensor:
        """Exact negative log density of the step, up to a constant, ``(...)``."""
        return bath.nll(self.before, self.after, params, dt / 2).sum(0)

    def squared_error(self) -> Tensor:
        """What the forces alone leave unexplained, ``(...)``."""
        return (self.after - self.before).square().sum((0, -2, -1))


def half_steps(
    head: Hamiltonian,
    start: PhaseState,
    step: PhaseState,
    params: Parameters,
    dt: float,
    forces: tuple[Tensor, Tensor] | None = None,
) -> HalfSteps:
    """Undo one step of bath, leapfrog, bath: its two ends tell the noise of both halves.

    The position tells the first half's momentum, so that the density of the whole step is a
    product of two of the bath's own: no bias of order dt, at any dt.

    Args:
        head: a Hamiltonian model with the kinetic energy |p|^2 / 2m, stepped by leapfrog.
        start: where the step began.
        step: its increments of q and p.
        params: of the episode.
        dt: seconds.
        forces: at both ends, where they are known already.

    Raises:
        ValueError: another kinetic energy or integrator.
    """
    if not isinstance(head.kinetic, FixedKinetic) or head.integrator != leapfrog:
        raise ValueError("half_steps: needs the kinetic energy |p|^2 / 2m and leapfrog")
    if forces is None:
        after = PhaseState(start.q + step.q, start.p + step.p)
        forces = head.force(start, params), head.force(after, params)
    opening, closing = forces
    first = params.mass.unsqueeze(-1) * step.q / dt - 0.5 * dt * opening
    second = first + 0.5 * dt * (opening + closing)
    return HalfSteps(torch.stack([start.p, second]), torch.stack([first, start.p + step.p]))
