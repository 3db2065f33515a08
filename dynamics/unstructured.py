"""The unstructured twin: a residual network that maps a state to the next one (inventory M1)."""

from __future__ import annotations

import torch
from torch import Tensor

from dynamics.head import Head
from dynamics.integrators import Memory
from dynamics.mlp import MLP, SILU
from dynamics.state import Parameters, PhaseState


class ResidualMap(Head):
    """x' = x + scale * g(x, c), with no structure beyond the residual.

    A map has no time step of its own choosing: it is trained for one ``dt`` and refuses others.

    Args:
        bodies, space: sizes of the state.
        conditions: entries of the parameters' vector.
        width: of the three hidden layers (139,020 parameters at 256, three bodies in a plane).
        dt: seconds that one application stands for.
    """

    dt: float  # a map always has one
    scale: Tensor

    def __init__(self, bodies: int, space: int, conditions: int, width: int, dt: float) -> None:
        super().__init__()
        self.bodies, self.space, self.dt = bodies, space, dt
        size = 2 * bodies * space
        self.network = MLP((size + conditions, width, width, width, size), SILU)
        self.register_buffer("scale", torch.ones(size))

    def set_scale(self, q: float, p: float) -> None:
        """Set the sizes of one step's increments, world units and momentum units."""
        half = self.bodies * self.space
        self.scale = torch.cat([torch.full((half,), q), torch.full((half,), p)]).to(self.scale)

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        """One step.

        Raises:
            ValueError: ``dt`` is not the one that the map was trained for.
        """
        if abs(dt - self.dt) > 1e-9:
            raise ValueError(
                f"ResidualMap: trained for dt = {self.dt:g} s, cannot step by {dt:g} s; "
                "roll it at its own dt"
            )
        x = state.flat
        x = x + self.scale * self.network(torch.cat([x, params.flat], -1))
        return PhaseState.from_flat(x, self.bodies, self.space), memory

    def force(self, state: PhaseState, params: Parameters) -> Tensor:
        """The momentum that one step adds, per second: the map's effective force."""
        after, _ = self.advance(state, params, self.dt)
        return (after.p - state.p) / self.dt
