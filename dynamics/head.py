"""What every dynamics head offers, learned or exact."""

from __future__ import annotations

from abc import ABC, abstractmethod

from torch import Tensor, nn

from dynamics.integrators import Memory
from dynamics.state import Parameters, PhaseState


class Head(nn.Module, ABC):
    """A law that can be stepped.

    Attributes:
        dt: seconds of one application of a transition map, which has no other step; ``None``
            for a vector field, which may be stepped by any.
    """

    dt: float | None = None

    @abstractmethod
    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        """One step of ``dt`` seconds; ``memory`` is what the last step handed over."""

    @abstractmethod
    def force(self, state: PhaseState, params: Parameters) -> Tensor:
        """dp/dt of the conservative part; of a map, all that it adds to p per second."""

    def check(self, params: Parameters) -> None:
        """Refuse parameters under which the model means nothing; a rollout asks before it starts.

        Raises:
            ValueError: what is impossible, and what to do.
        """

    def set_scale(self, q: float, p: float) -> None:
        """Be told the sizes of one step's increments; most heads have no use for them."""
