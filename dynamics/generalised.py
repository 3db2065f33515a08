"""Models in generalised coordinates: a metric M(q) and a potential, in two formalisms.

The state is (q, p) with p = M(q) dq/dt in both. Sources: the study's appendix B; SymODEN
(Zhong, Dey and Chakraborty, ICLR 2020); DeLaN (Lutter, Ritter and Peters, ICLR 2019); the
integrator of Tao, Phys. Rev. E 94, 043303 (2016).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, cast, runtime_checkable

from jaxtyping import Float
from torch import Tensor, nn

from dynamics.angles import AnglePotential
from dynamics.domain import MOMENTUM
from dynamics.friction import Friction
from dynamics.head import Head
from dynamics.integrators import Integrator, Memory, VectorField, tao, tao_gate
from dynamics.metric import CholeskyMetric
from dynamics.potentials import Potential
from dynamics.state import Parameters, PhaseState


@runtime_checkable
class Metric(Protocol):
    """What a mass matrix M(q) offers; vectors are ``(..., n)``."""

    def velocity(self, q: Float[Tensor, "*b n"], p: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n"]:
        """M(q)^-1 p."""

    def momentum(self, q: Float[Tensor, "*b n"], v: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n"]:
        """M(q) v."""

    def inverse(self, q: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n n"]:
        """M(q)^-1."""

    def hamilton(
        self, q: Float[Tensor, "*b n"], p: Float[Tensor, "*b n"]
    ) -> tuple[Float[Tensor, "*b n"], Float[Tensor, "*b n"]]:
        """The velocity M^-1 p, and -d/dq of 1/2 p^T M(q)^-1 p."""


class Generalised(Head):
    """What both formalisms share: metric, potential, joint friction and the step.

    Args:
        metric: of the kinetic energy.
        potential: of the joint angles.
        integrator: a method for a field that is not separable.
        dt: seconds of the model's step, which is also the one that Tao's gate is held at.
        ports: joint friction; half acts before the integrator's step and half after.

    Raises:
        ValueError: the integrator needs a separable field, or Tao's gate fails at ``dt``.
    """

    def __init__(
        self,
        metric: Metric,
        potential: Potential,
        integrator: Integrator,
        dt: float,
        ports: Sequence[Friction] = (),
    ) -> None:
        super().__init__()
        if integrator.needs_separable:
            raise ValueError(f"{type(self).__name__}: {integrator.name} needs a separable field")
        if integrator is tao:
            tao_gate(dt)
        self.metric, self.potential = metric, potential
        self.integrator, self.told_for = integrator, dt
        self.ports = nn.ModuleList(ports)

    def set_scale(self, q: float, p: float) -> None:
        """Be told the sizes of one step's increments, radians and momentum units."""
        if isinstance(self.potential, AnglePotential):
            self.potential.set_scale(p / self.told_for)

    def velocity(self, state: PhaseState) -> Tensor:
        """dq/dt = M(q)^-1 p, ``(..., n, 1)``."""
        return self.metric.velocity(state.q.flatten(-2), state.p.flatten(-2)).unsqueeze(-1)

    @property
    def conserves(self) -> bool:
        return not len(self.ports)

    @property
    def depends_on(self) -> tuple[str, ...]:
        return (MOMENTUM,)  # the angles come back to where they were; the slopes do not

    def energy(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b"]:
        """H of each state, shape of the batch."""
        kinetic = 0.5 * (self.velocity(state) * state.p).sum((-2, -1))
        return kinetic + self.potential.energy(state.q, params)

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return self._hamilton(state, params)[1]

    def slopes(self, state: PhaseState, params: Parameters) -> tuple[Tensor, Tensor]:
        """(dq/dt, dp/dt) with friction, ``(..., n, 1)`` each.

        dp/dt = dL/dq + friction, which Hamilton and Euler-Lagrange agree on.
        """
        velocity, force = self._hamilton(state, params)
        for port in self.ports:
            force = force + cast(Friction, port).force(velocity, params)
        return velocity, force

    def _hamilton(self, state: PhaseState, params: Parameters) -> tuple[Tensor, Tensor]:
        velocity, bent = self.metric.hamilton(state.q.flatten(-2), state.p.flatten(-2))
        force = bent.unsqueeze(-1) + self.potential.force(state.q, params)
        return velocity.unsqueeze(-1), force

    def check(self, params: Parameters) -> None:
        for port in self.ports:
            cast(Friction, port).check(params)

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        if not self.ports:
            return self._conserve(state, params, dt, memory)
        state = self._resisted(list(self.ports), state, params, dt / 2)
        # The ports have moved p, so that nothing of the last step can be used again.
        state, _ = self._conserve(state, params, dt, None)
        return self._resisted(list(self.ports)[::-1], state, params, dt / 2), None

    def _resisted(
        self, ports: Sequence[nn.Module], state: PhaseState, params: Parameters, dt: float
    ) -> PhaseState:
        mobility = self.metric.inverse(state.q.flatten(-2))
        for port in ports:
            p = cast(Friction, port).resist(state.p.squeeze(-1), mobility, params, dt)
            state = PhaseState(state.q, p.unsqueeze(-1))
        return state

    def _conserve(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory
    ) -> tuple[PhaseState, Memory]:
        raise NotImplementedError


class GeneralisedHamiltonian(Generalised):
    """H = p^T M(q)^-1 p / 2 + V(q, c) by Hamilton's equations."""

    def _conserve(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory
    ) -> tuple[PhaseState, Memory]:
        def slopes(q: Tensor, p: Tensor) -> tuple[Tensor, Tensor]:
            return self._hamilton(PhaseState(q, p), params)

        return self.integrator.advance(VectorField.joint(slopes), state, dt, memory)


class Lagrangian(Generalised):
    """L = v^T M(q) v / 2 - V(q, c) by the Euler-Lagrange equations, stepped in (q, dq/dt)."""

    def _conserve(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory
    ) -> tuple[PhaseState, Memory]:
        def slopes(q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
            turn, rate = q.flatten(-2), v.flatten(-2)
            force = self.potential.force(q, params).flatten(-2)
            push = force + cast(CholeskyMetric, self.metric).coriolis(turn, rate)
            return v, self.metric.velocity(turn, push).unsqueeze(-1)

        moving = PhaseState(state.q, self.velocity(state))
        field = VectorField.joint(slopes)
        moving, memory = self.integrator.advance(field, moving, dt, memory)
        momentum = self.metric.momentum(moving.q.flatten(-2), moving.p.flatten(-2))
        return PhaseState(moving.q, momentum.unsqueeze(-1)), memory
