"""A Hamiltonian H = T(p) + V(q, c), learned or exact, stepped by a symplectic integrator."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import cast

from jaxtyping import Float
from torch import Tensor, nn

from dynamics.domain import FARTHEST, MOMENTUM, NEAREST, ORIGIN
from dynamics.findings import Finding
from dynamics.head import Head
from dynamics.integrators import Integrator, Memory, VectorField, leapfrog
from dynamics.kinetic import FixedKinetic, Kinetic
from dynamics.ports import Port
from dynamics.potentials import NoPotential, PairPotential, Potential
from dynamics.state import Parameters, PhaseState


class Hamiltonian(Head):
    """A kinetic and a potential energy, composed.

    Args:
        kinetic: has ``energy(p, params)`` and ``velocity(p, params)``.
        potential: has ``energy(q, params)`` and ``force(q, params)``.
        integrator: the one-step method of :meth:`advance`.
        ports: where energy enters or leaves; none for a conservative model. Half of each acts
            before the integrator's step and half after, in the opposite order (Strang splitting,
            second order).

    Example:
        >>> import torch
        >>> from dynamics.potentials import HarmonicTrap
        >>> spring = Hamiltonian(FixedKinetic(), HarmonicTrap(1.0))
        >>> state = PhaseState(torch.ones(1, 1, 1), torch.zeros(1, 1, 1))
        >>> law = Parameters(torch.ones(1), torch.ones(1, 1))
        >>> spring.energy(state, law).tolist(), spring.force(state, law).flatten().tolist()
        ([0.5], [-1.0])
    """

    def __init__(
        self,
        kinetic: Kinetic,
        potential: Potential,
        integrator: Integrator = leapfrog,
        ports: Sequence[Port] = (),
    ) -> None:
        super().__init__()
        self.kinetic = kinetic
        self.potential = potential
        self.integrator = integrator
        self.ports = nn.ModuleList(ports)

    @property
    def conserves(self) -> bool:
        works = any(cast(Port, port).works for port in self.ports)
        return not works and getattr(self.potential, "conservative", True)

    @property
    def box(self) -> float | None:
        return next((part.law.box for part in self.pair_laws()), None)

    @property
    def depends_on(self) -> tuple[str, ...]:
        where = (FARTHEST, NEAREST) if self.pair_laws() else (ORIGIN,)
        return (*_if_learned(self.potential, where), *_if_learned(self.kinetic, (MOMENTUM,)))

    def pair_laws(self) -> list[PairPotential]:
        """The potential's parts that are functions of one displacement."""
        parts = cast(nn.Module, self.potential).modules()
        return [part for part in parts if isinstance(part, PairPotential)]

    def energy(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b"]:
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
        if not self.ports:
            return self.integrator.advance(self.field(params), state, dt, memory)
        state = self._kicked(self.ports, state, params, dt / 2)
        # A port has moved p since the last step: only a force that ignores p can be re-used.
        kept = memory if self.integrator.needs_separable else None
        state, memory = self.integrator.advance(self.field(params), state, dt, kept)
        return self._kicked(reversed(self.ports), state, params, dt / 2), memory

    @staticmethod
    def _kicked(
        ports: Iterable[nn.Module], state: PhaseState, params: Parameters, dt: float
    ) -> PhaseState:
        for port in ports:
            state = PhaseState(state.q, cast(Port, port).kick(state, params, dt))
        return state

    def check(self, params: Parameters) -> None:
        for port in self.ports:
            cast(Port, port).check(params)

    def concerns(self, params: Parameters, start: PhaseState | None = None) -> list[Finding]:
        return [said for port in self.ports for said in cast(Port, port).concerns(params)]

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        """dp/dt of the conservative part at a state, ``(..., n, d)``."""
        return self.potential.force(state.q, params)

    def derivatives(self, state: PhaseState, params: Parameters) -> PhaseState:
        """dq/dt and dp/dt at a state, those of the ports among them, ``(..., n, d)`` each.

        The noise of a bath has no derivative and is left out.
        """
        drifts = (cast(Port, port).drift(state, params) for port in self.ports)
        force = sum(drifts, self.force(state, params))
        return PhaseState(self.kinetic.velocity(state.p, params), force)


def _if_learned(part: object, names: tuple[str, ...]) -> tuple[str, ...]:
    learned = next(cast(nn.Module, part).parameters(), None) is not None
    return names if learned else ()


def ballistic() -> Hamiltonian:
    """Straight lines at constant speed: the predictor with no force at all.

    Example:
        >>> import torch
        >>> state = PhaseState(torch.zeros(1, 1, 1), torch.ones(1, 1, 1))
        >>> law = Parameters(torch.ones(1), torch.ones(1, 1))
        >>> later, _ = ballistic().advance(state, law, dt=0.5)
        >>> later.q.flatten().tolist()
        [0.5]
    """
    return Hamiltonian(FixedKinetic(), NoPotential())
