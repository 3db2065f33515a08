"""Transition maps: networks that give a step's increment, trained for one dt and no other."""

from __future__ import annotations

from abc import abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor

from dynamics.head import Head
from dynamics.integrators import Memory
from dynamics.state import Parameters, PhaseState


class TransitionMap(Head):
    """x' = x + scale * increment(x, c).

    A map has no time step of its own choosing: it is trained for one ``dt`` and refuses others.

    Args:
        dt: seconds that one application stands for.
    """

    dt: float  # a map always has one
    scale: Tensor

    def __init__(self, dt: float) -> None:
        super().__init__()
        self.dt = dt
        self.register_buffer("scale", torch.ones(2))

    @abstractmethod
    def increment(self, state: PhaseState, params: Parameters) -> PhaseState:
        """What one step adds to q and to p, in units of ``scale``."""

    def set_scale(self, q: float, p: float) -> None:
        """Set the sizes of one step's increments, world units and momentum units."""
        self.scale = torch.tensor([q, p]).to(self.scale)

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        """One step.

        Raises:
            ValueError: ``dt`` is not the one that the map was trained for.
        """
        self.check_step(dt)
        step = self.increment(state, params)
        after = PhaseState(state.q + self.scale[0] * step.q, state.p + self.scale[1] * step.p)
        return after, memory

    def check_step(self, dt: float) -> None:
        """Refuse a step that the map was not trained for.

        Raises:
            ValueError: which one it was.
        """
        if abs(dt - self.dt) > 1e-9:
            raise ValueError(
                f"{type(self).__name__}: trained for dt = {self.dt:g} s, cannot step by {dt:g} s; "
                "roll it at its own dt"
            )

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        """The momentum that one step adds, per second: the map's effective force."""
        return self.scale[1] * self.increment(state, params).p / self.dt
