"""Ports: where energy enters or leaves an otherwise Hamiltonian model."""

from __future__ import annotations

import torch
from torch import Tensor, nn

SLOW = -3.0  # raw start value: softplus(-3) is a rate of 0.05 per second


class LinearFriction(nn.Module):
    """dp/dt = -gamma p, stepped exactly: p <- p exp(-gamma dt) (inventory I6, M28).

    gamma = softplus(raw) is positive by construction, so the port can only take energy.
    """

    def __init__(self) -> None:
        super().__init__()
        self.raw = nn.Parameter(torch.tensor(SLOW))

    @property
    def rate(self) -> Tensor:
        """gamma, per second."""
        return nn.functional.softplus(self.raw)

    def damp(self, p: Tensor, dt: float) -> Tensor:
        """Momentum after ``dt`` seconds of friction alone."""
        return p * torch.exp(-self.rate * dt)
