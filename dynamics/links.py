"""Rods that hang end on end under gravity: the metric and the potential of their angles.

Angles are from hanging straight down, and each is the rod's own, not from the rod before. With
w_i the mass at or below the end of rod i, V = -g sum_i w_i l_i cos s_i and
T = 1/2 sum_ij w_max(i,j) l_i l_j cos(s_i - s_j) v_i v_j + 1/2 sum_i I_i v_i^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.generalised import GeneralisedHamiltonian
from dynamics.head import Head
from dynamics.integrators import Memory
from dynamics.numbers import number
from dynamics.state import Parameters, PhaseState


class LinkMetric(nn.Module):
    """The mass matrix; vectors are ``(..., n)``.

    Args:
        lengths: of the rods, ``(n,)``.
        masses: at their ends, ``(n,)``.
        inertia: of each rod beyond that of its mass, ``(n,)``; may be below zero where a rod's
            centre lies nearer to its joint.
        learned: whether masses and inertia are; only their ratios mean anything.
    """

    lengths: Tensor
    masses: Tensor
    inertia: Tensor

    def __init__(
        self,
        lengths: Sequence[float],
        masses: Sequence[float],
        inertia: Sequence[float],
        learned: bool,
    ) -> None:
        super().__init__()
        number(self, "lengths", lengths, False)
        number(self, "masses", masses, learned)
        number(self, "inertia", inertia, learned)

    def weights(self, like: Tensor) -> Tensor:
        """Mass at or below the end of each rod, times its length, ``(n,)``."""
        return self._below(like) * self.lengths.to(like)

    def velocity(self, q: Float[Tensor, "*b n"], p: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n"]:
        """M(q)^-1 p."""
        return torch.linalg.solve(self._matrix(q), p)

    def momentum(self, q: Float[Tensor, "*b n"], v: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n"]:
        """M(q) v."""
        return (self._matrix(q) @ v.unsqueeze(-1)).squeeze(-1)

    def inverse(self, q: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n n"]:
        """M(q)^-1."""
        return torch.linalg.inv(self._matrix(q))

    def hamilton(
        self, q: Float[Tensor, "*b n"], p: Float[Tensor, "*b n"]
    ) -> tuple[Float[Tensor, "*b n"], Float[Tensor, "*b n"]]:
        """The velocity M^-1 p, and -d/dq of 1/2 p^T M(q)^-1 p."""
        v = self.velocity(q, p)
        return v, self.bent(q, v)

    def bent(self, q: Float[Tensor, "*b n"], v: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n"]:
        """d/dq of 1/2 v^T M(q) v at fixed v."""
        turn = self._reach(q) * (q.unsqueeze(-1) - q.unsqueeze(-2)).sin()
        return -v * (turn * v.unsqueeze(-2)).sum(-1)

    def _below(self, like: Tensor) -> Tensor:
        return self.masses.to(like).flip(0).cumsum(0).flip(0)

    def _reach(self, like: Tensor) -> Tensor:
        """w_max(i,j) l_i l_j, ``(n, n)``."""
        below, lengths = self._below(like), self.lengths.to(like)
        rods = torch.arange(len(lengths), device=like.device)
        lower = torch.maximum(rods[:, None], rods[None])
        return below[lower] * lengths[:, None] * lengths

    def _matrix(self, q: Tensor) -> Tensor:
        apart = q.unsqueeze(-1) - q.unsqueeze(-2)
        return self._reach(q) * apart.cos() + self.inertia.to(q).diag()


class Hanging(nn.Module):
    """The potential of rods.

    Args:
        metric: has their weights.
        gravity: in units of length per second squared.
        learned: whether gravity is.
    """

    gravity: Tensor

    def __init__(self, metric: LinkMetric, gravity: float, learned: bool) -> None:
        super().__init__()
        self._metric = (metric,)  # in a tuple: its numbers are its own, and kept once
        number(self, "gravity", gravity, learned)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return -(self._pull(q) * q.squeeze(-1).cos()).sum(-1)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return -self._pull(q).unsqueeze(-1) * q.sin()

    def _pull(self, like: Tensor) -> Tensor:
        return self.gravity.to(like) * self._metric[0].weights(like)


class Links(Head):
    """Rods whose state tells how fast they turn, as tracks of angles do: p = m ds/dt.

    Args:
        within: the model in canonical momenta, which it is stepped in; of a :class:`LinkMetric`.
    """

    def __init__(self, within: GeneralisedHamiltonian) -> None:
        super().__init__()
        self.within = within

    @property
    def metric(self) -> LinkMetric:
        """The mass matrix."""
        return cast(LinkMetric, self.within.metric)

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        metric, mass = self.metric, params.mass
        v = state.p.squeeze(-1) / mass
        p = metric.momentum(state.q.squeeze(-1), v).unsqueeze(-1)
        later, _ = self.within.advance(PhaseState(state.q, p), params, dt)
        v = metric.velocity(later.q.squeeze(-1), later.p.squeeze(-1))
        return PhaseState(later.q, (mass * v).unsqueeze(-1)), None

    def energy(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b"]:
        """T + V of each state, shape of the batch."""
        v = state.p.squeeze(-1) / params.mass
        kinetic = 0.5 * (v * self.metric.momentum(state.q.squeeze(-1), v)).sum(-1)
        return kinetic + self.within.potential.energy(state.q, params)

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        """-dE/dq at fixed rates, ``(..., n, 1)``."""
        v = state.p.squeeze(-1) / params.mass
        bent = self.metric.bent(state.q.squeeze(-1), v).unsqueeze(-1)
        return self.within.potential.force(state.q, params) - bent

    def check(self, params: Parameters) -> None:
        self.within.check(params)

    @property
    def conserves(self) -> bool:
        return self.within.conserves

    @property
    def depends_on(self) -> tuple[str, ...]:
        return ()  # a few numbers, which mean the same everywhere
