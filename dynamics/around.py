"""Models around a Hamiltonian one, whose steps they amend."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from dynamics.findings import Finding
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head
from dynamics.state import Parameters, PhaseState


class Around(Head):
    """A model that steps a Hamiltonian one and amends what comes of it, as a wall does.

    Energy and force are those of the model within: what amends a step stores none.

    Args:
        free: the model within.
    """

    def __init__(self, free: Hamiltonian) -> None:
        super().__init__()
        self.free = free

    def energy(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b"]:
        """Of the model within."""
        return self.free.energy(state, params)

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return self.free.force(state, params)

    def check(self, params: Parameters) -> None:
        self.free.check(params)

    def concerns(self, params: Parameters, start: PhaseState | None = None) -> list[Finding]:
        return self.free.concerns(params, start)

    @property
    def box(self) -> float | None:
        return self.free.box

    @property
    def depends_on(self) -> tuple[str, ...]:
        return self.free.depends_on
