"""The unstructured twins: one network of the whole state, as a map or as a flow."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from dynamics.angles import Harmonics
from dynamics.domain import MOMENTUM, ORIGIN
from dynamics.head import Head
from dynamics.integrators import Integrator, Memory, VectorField, rk4
from dynamics.maps import TransitionMap
from dynamics.mlp import MLP, SILU
from dynamics.state import Parameters, PhaseState


class ResidualMap(TransitionMap):
    """x' = x + scale * g(x, c), with no structure beyond the residual.

    Args:
        bodies, space: sizes of the state.
        conditions: entries of the parameters' vector.
        width: of the three hidden layers (139,020 parameters at 256, three bodies in a plane).
        dt: seconds that one application stands for.
        angles: whether q are joint angles, which the network then sees as harmonics.
    """

    def __init__(
        self, bodies: int, space: int, conditions: int, width: int, dt: float, angles: bool = False
    ) -> None:
        super().__init__(dt)
        self.harmonics = Harmonics(bodies * space) if angles else None
        extra = self.harmonics.size - bodies * space if self.harmonics else 0
        self.network = _state_network(bodies, space, conditions + extra, width)

    @property
    def depends_on(self) -> tuple[str, ...]:
        return (ORIGIN, MOMENTUM) if self.harmonics is None else (MOMENTUM,)

    def increment(self, state: PhaseState, params: Parameters) -> PhaseState:
        if self.harmonics is None:
            return _answer(self.network, state, params)
        q, p = self.harmonics(state.q.flatten(-2)), state.p.flatten(-2)
        out = self.network(torch.cat([q, p, params.flat], -1))
        return PhaseState.from_flat(out, state.q.shape[-2], state.q.shape[-1])


class NeuralODE(Head):
    """dx/dt = rate * g(x, c), the same network as a vector field
    (neural ODE, Chen et al., NeurIPS 2018).

    Args:
        bodies, space: sizes of the state.
        conditions: entries of the parameters' vector.
        width: of the three hidden layers.
        dt: seconds of the step that the sizes of increments will be told for.
        integrator: a method for a field that is not separable.
    """

    rate: Tensor

    def __init__(
        self,
        bodies: int,
        space: int,
        conditions: int,
        width: int,
        dt: float,
        integrator: Integrator = rk4,
    ) -> None:
        super().__init__()
        self.told_for, self.integrator = dt, integrator
        self.network = _state_network(bodies, space, conditions, width)
        self.register_buffer("rate", torch.ones(2))

    def set_scale(self, q: float, p: float) -> None:
        """Set the sizes of one step's increments, world units and momentum units."""
        self.rate = (torch.tensor([q, p]) / self.told_for).to(self.rate)

    @property
    def depends_on(self) -> tuple[str, ...]:
        return (ORIGIN, MOMENTUM)

    def slopes(self, state: PhaseState, params: Parameters) -> tuple[Tensor, Tensor]:
        """(dq/dt, dp/dt)."""
        found = _answer(self.network, state, params)
        return self.rate[0] * found.q, self.rate[1] * found.p

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        field = VectorField.joint(lambda q, p: self.slopes(PhaseState(q, p), params))
        return self.integrator.advance(field, state, dt, memory)

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return self.slopes(state, params)[1]


def _state_network(bodies: int, space: int, conditions: int, width: int) -> MLP:
    size = 2 * bodies * space
    return MLP((size + conditions, width, width, width, size), SILU)


def _answer(network: MLP, state: PhaseState, params: Parameters) -> PhaseState:
    """The network's output in the form of a state."""
    out = network(torch.cat([state.flat, params.flat], -1))
    return PhaseState.from_flat(out, state.q.shape[-2], state.q.shape[-1])
