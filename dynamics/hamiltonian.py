"""A Hamiltonian H = T(p) + V(q, c), learned or exact, stepped by a symplectic integrator."""

from __future__ import annotations

from torch import Tensor, nn

from dynamics.integrators import Integrator, Memory, VectorField, leapfrog
from dynamics.kinetic import FixedKinetic, Kinetic
from dynamics.ports import LinearFriction
from dynamics.potentials import NoPotential, Potential
from dynamics.state import Parameters, PhaseState


class Hamiltonian(nn.Module):
    """A kinetic and a potential energy, composed.

    Args:
        kinetic: has ``energy(p, params)`` and ``velocity(p, params)``.
        potential: has ``energy(q, params)`` and ``force(q, params)``.
        integrator: the one-step method of :meth:`advance`.
        friction: a port that takes energy, or ``None`` for a conservative model. Half of it acts
            before and half after the integrator's step (Strang splitting, second order).
    """

    def __init__(
        self,
        kinetic: Kinetic,
        potential: Potential,
        integrator: Integrator = leapfrog,
        friction: LinearFriction | None = None,
    ) -> None:
        super().__init__()
        self.kinetic = kinetic
        self.potential = potential
        self.integrator = integrator
        self.friction = friction

    def energy(self, state: PhaseState, params: Parameters) -> Tensor:
        """H of each state, shape of the batch."""
        return self.kinetic.energy(state.p, params) + self.potential.energy(state.q, params)

    def field(self, params: Parameters) -> VectorField:
        """Hamilton's equations with the parameters bound."""
        return VectorField(
            velocity=lambda q, p: self.kinetic.velocity(p, params),
            force=lambda q, p: self.potential.force(q, params),
        )

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        """One step of ``dt`` seconds; ``memory`` is what the last step handed over."""
        if self.friction is None:
            return self.integrator.advance(self.field(params), state, dt, memory)
        state = PhaseState(state.q, self.friction.damp(state.p, dt / 2))
        state, memory = self.integrator.advance(self.field(params), state, dt, memory)
        return PhaseState(state.q, self.friction.damp(state.p, dt / 2)), memory

    def force(self, state: PhaseState, params: Parameters) -> Tensor:
        """dp/dt of the conservative part at a state, ``(..., n, d)``."""
        return self.potential.force(state.q, params)


def ballistic() -> Hamiltonian:
    """Straight lines at constant speed: the predictor with no force at all."""
    return Hamiltonian(FixedKinetic(), NoPotential())
