"""Bodies that slide along a curve under a uniform field, with dry friction by what presses them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.around import Around
from dynamics.curves import ByLength
from dynamics.hamiltonian import Hamiltonian
from dynamics.integrators import Memory
from dynamics.numbers import number
from dynamics.state import Parameters, PhaseState


class Along(nn.Module):
    """V = -sum_i m_i g . q(s_i) of coordinates s along a curve q.

    Args:
        curve: that the bodies are bound to.
        acceleration: g, ``(d,)``, of the picture, world units per second squared.
        learned: whether it is.

    Raises:
        ValueError: an acceleration of other dimensions than the curve's.
    """

    acceleration: Tensor

    def __init__(
        self, curve: ByLength, acceleration: Sequence[float], learned: bool = True
    ) -> None:
        super().__init__()
        space = curve.place(torch.zeros(1, 1)).shape[-1]
        if len(acceleration) != space:
            raise ValueError(
                f"Along: acceleration must have {space} numbers, one of each dimension of the "
                f"curve, got {tuple(acceleration)}"
            )
        self._bound = (curve,)  # a part of the model around, and so hidden from torch here
        number(self, "acceleration", acceleration, learned)

    @property
    def curve(self) -> ByLength:
        """That the bodies are bound to."""
        return self._bound[0]

    def energy(self, q: Float[Tensor, "*b n 1"], params: Parameters) -> Float[Tensor, "*b"]:
        return -(params.mass * (self.curve.place(q) @ self.acceleration.to(q))).sum(-1)

    def force(self, q: Float[Tensor, "*b n 1"], params: Parameters) -> Float[Tensor, "*b n 1"]:
        pull = self.curve.tangent(q) @ self.acceleration.to(q)
        return (params.mass * pull).unsqueeze(-1)

    def pressing(self, s: Float[Tensor, "*b n 1"]) -> tuple[Tensor, Tensor]:
        """What presses a unit mass to the curve there: its bend, which goes with the square of the
        rate, and the field across it, ``(..., n, d)`` each.
        """
        tangent, field = self.curve.tangent(s), self.acceleration.to(s)
        return self.curve.bend(s), field - (tangent @ field).unsqueeze(-1) * tangent


class Rubbed(Around):
    """Dry friction on a curve: a share of what presses a body to it (Amontons and Coulomb).

    Half of it acts before a step of the model within and half after. A body that turns round
    where friction is stronger than what pulls it along stays there.

    Args:
        free: the model without it, with the potential :class:`Along`.
        coefficient: the share, zero or above.
        learned: whether it is.

    Raises:
        ValueError: a model without such a potential, or a coefficient below zero.
    """

    coefficient: Tensor

    def __init__(self, free: Hamiltonian, coefficient: float, learned: bool = True) -> None:
        super().__init__(free)
        if not coefficient >= 0:
            raise ValueError(f"Rubbed: coefficient must be >= 0, got {coefficient}")
        if not any(isinstance(part, Along) for part in free.modules()):
            raise ValueError("Rubbed: needs a potential Along, which says what presses to a curve")
        number(self, "coefficient", coefficient, learned)

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        before = self._along.pressing(state.q)
        later, _ = self.free.advance(self._slowed(state, before, params, dt / 2), params, dt)
        later = self._slowed(later, self._along.pressing(later.q), params, dt / 2)
        holds = self._lost(before, torch.zeros_like(state.p)) * params.mass.unsqueeze(-1)
        rests = (state.p * later.p <= 0) & (self.force(state, params).abs() <= holds)
        q, p = torch.where(rests, state.q, later.q), torch.where(rests, 0, later.p)
        return PhaseState(q, p), None

    def _slowed(
        self, state: PhaseState, pressing: tuple[Tensor, Tensor], params: Parameters, dt: float
    ) -> PhaseState:
        """After ``dt`` seconds of friction where it is, by its half-way speed (second order)."""
        mass = params.mass.unsqueeze(-1)
        rate = state.p / mass
        middle = _less(rate, self._lost(pressing, rate) * dt / 2)
        return PhaseState(state.q, mass * _less(rate, self._lost(pressing, middle) * dt))

    def _lost(self, pressing: tuple[Tensor, Tensor], rate: Tensor) -> Tensor:
        """The deceleration, world units per second squared."""
        bend, across = pressing
        pressed = (bend * rate.square() - across).norm(dim=-1, keepdim=True)
        return self.coefficient.clamp_min(0).to(rate) * pressed

    @property
    def _along(self) -> Along:
        return next(part for part in self.free.modules() if isinstance(part, Along))


def _less(rate: Tensor, lost: Tensor) -> Tensor:
    """A rate by so much nearer to zero."""
    return rate.sign() * (rate.abs() - lost).clamp_min(0)
