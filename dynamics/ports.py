"""Ports: where energy enters or leaves an otherwise Hamiltonian model.

A port is a flow of the momenta alone, stepped exactly where a closed form exists.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.findings import Finding
from dynamics.numbers import number
from dynamics.state import Parameters, PhaseState

SLOW = -3.0  # raw start value: softplus(-3) is a rate of 0.05 per second


class Port(nn.Module):
    """A flow of the momenta that acts beside Hamilton's equations.

    Attributes:
        works: of the class: whether it gives or takes energy.
    """

    works: ClassVar[bool] = True

    def kick(self, state: PhaseState, params: Parameters, dt: float) -> Float[Tensor, "*b n d"]:
        """Momenta after ``dt`` seconds of this port alone, ``(..., n, d)``."""
        raise NotImplementedError

    def drift(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        """dp/dt of this port alone, without its noise where it has any, ``(..., n, d)``."""
        raise NotImplementedError

    def check(self, params: Parameters) -> None:
        """Refuse parameters under which the port means nothing, with ``ValueError``."""

    def concerns(self, params: Parameters) -> list[Finding]:
        """What must be said of the port before it acts under these parameters."""
        return []


class LinearFriction(Port):
    """dp/dt = -gamma p, stepped exactly: p <- p exp(-gamma dt).

    gamma = softplus(raw) is positive by construction, so the port can only take energy.
    """

    def __init__(self) -> None:
        super().__init__()
        self.raw = nn.Parameter(torch.tensor(SLOW))

    @property
    def rate(self) -> Tensor:
        """gamma, per second."""
        return nn.functional.softplus(self.raw)

    def kick(self, state: PhaseState, params: Parameters, dt: float) -> Float[Tensor, "*b n d"]:
        return state.p * torch.exp(-self.rate * dt)

    def drift(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return -self.rate * state.p


class PlacewiseFriction(Port):
    """dp/dt = -(a + b q + c q^2) dq/dt of coordinates on a line, stepped exactly at each place.

    Where the sum is below zero it adds energy, as it does near the middle in van der Pol's
    oscillator (1926, Phil. Mag. 2).

    Args:
        rates: a, b and c, per second and per world unit.
        learned: whether they are.

    Example:
        >>> air = PlacewiseFriction((-1.0, 0.0, 1.0), learned=False)
        >>> state = PhaseState(torch.tensor([[1.0], [0.0]]), torch.ones(2, 1))
        >>> law = Parameters(torch.ones(()), torch.ones(2))
        >>> [round(float(p), 3) for p in air.kick(state, law, dt=1.0)]  # at 1 and at 0
        [1.0, 2.718]
    """

    rates: Tensor

    def __init__(self, rates: Sequence[float], learned: bool = True) -> None:
        super().__init__()
        number(self, "rates", rates, learned)

    def kick(self, state: PhaseState, params: Parameters, dt: float) -> Float[Tensor, "*b n d"]:
        return state.p * torch.exp(-self._rate(state, params) * dt)

    def drift(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return -self._rate(state, params) * state.p

    def _rate(self, state: PhaseState, params: Parameters) -> Tensor:
        """Per second, at each place."""
        a, b, c = self.rates.to(state.q)
        return (a + state.q * (b + state.q * c)) / params.mass.unsqueeze(-1)


class Turning(Port):
    """dp/dt = rate x p, stepped exactly: velocities turn and lose nothing, as by a magnetic field.

    Args:
        rate: radians per second, ``(1,)`` in the plane, about the axis out of it, or ``(3,)``.
        learned: whether it is.

    Example:
        >>> turn = Turning((torch.pi,), learned=False)
        >>> east = PhaseState(torch.zeros(1, 2), torch.tensor([[1.0, 0.0]]))
        >>> law = Parameters(torch.ones(()), torch.ones(1))
        >>> turn.kick(east, law, dt=0.5).round(decimals=6).tolist()  # north
        [[-0.0, 1.0]]
    """

    works = False
    rate: Tensor

    def __init__(self, rate: Sequence[float], learned: bool = True) -> None:
        super().__init__()
        number(self, "rate", rate, learned)

    def kick(self, state: PhaseState, params: Parameters, dt: float) -> Float[Tensor, "*b n d"]:
        return turned(state.p, self.rate.to(state.p) * dt)

    def drift(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return _cross(self.rate.to(state.p), state.p)


def turned(p: Float[Tensor, "*b n d"], angle: Tensor) -> Float[Tensor, "*b n d"]:
    """Momenta turned about an axis by an angle in radians: ``(…, 1)`` in the plane, or ``(…, 3)``.

    By Rodrigues' formula; sin(x) / x and (1 - cos(x)) / x^2 = (sin(x/2) / (x/2))^2 / 2.
    """
    size, across = angle.norm(dim=-1, keepdim=True), _cross(angle, p)
    return p + _sinc(size) * across + 0.5 * _sinc(size / 2).square() * _cross(angle, across)


def _cross(rate: Tensor, p: Tensor) -> Tensor:
    if p.shape[-1] == 2:
        return rate * torch.stack([-p[..., 1], p[..., 0]], -1)
    return torch.linalg.cross(rate.expand_as(p), p)


def _sinc(x: Tensor) -> Tensor:
    """Sin(x) / x."""
    return torch.sinc(x / torch.pi)
