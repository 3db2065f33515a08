"""Ports: where energy enters or leaves an otherwise Hamiltonian model.

A port is a flow of the momenta alone, stepped exactly where a closed form exists.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.findings import Finding
from dynamics.state import Parameters, PhaseState

SLOW = -3.0  # raw start value: softplus(-3) is a rate of 0.05 per second


class Port(nn.Module):
    """A flow of the momenta that acts beside Hamilton's equations."""

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
