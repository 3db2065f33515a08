"""A graph-network simulator: messages between pairs of bodies, summed at each.

Battaglia et al., NeurIPS 2016; Sanchez-Gonzalez et al., ICML 2020.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dynamics.domain import FARTHEST, MOMENTUM, NEAREST
from dynamics.maps import TransitionMap
from dynamics.mlp import MLP, SILU
from dynamics.state import Parameters, PhaseState

MOST_MESSAGES = 2**22  # of one state: two gigabytes at width 128, and as much again in between


class GraphNetwork(TransitionMap):
    """Each body's increment from its momentum, its mass and the sum of its neighbours' messages.

    Positions enter by differences only, so that translation is built in.

    Args:
        space: dimensions of space.
        width: of all hidden layers and of a message.
        factored: G multiplies the summed messages and enters nowhere else; otherwise every
            network is told G.
        dt: seconds that one application stands for.
    """

    def __init__(self, space: int, width: int, factored: bool, dt: float) -> None:
        super().__init__(dt)
        self.factored = factored
        told = 0 if factored else 1
        self.message = MLP((2 * space + 2 + told, width, width, width), SILU)
        self.update = MLP((space + 1 + told + width, width, width, 2 * space), SILU)

    @property
    def depends_on(self) -> tuple[str, ...]:
        return (MOMENTUM, FARTHEST, NEAREST)

    def increment(self, state: PhaseState, params: Parameters) -> PhaseState:
        q, p, mass = state.q, state.p, params.mass.unsqueeze(-1)
        bodies = q.shape[-2]
        if bodies**2 > MOST_MESSAGES:
            raise ValueError(
                f"GraphNetwork: {bodies} bodies exchange {bodies**2:,} messages at once, more than "
                f"the {MOST_MESSAGES:,} that are held in memory; use fewer bodies"
            )
        coupling = params.coupling[..., None, None]
        ahead = q.unsqueeze(-3) - q.unsqueeze(-2)  # (..., i, j, d): from i to j
        closing = (p / mass).unsqueeze(-3) - (p / mass).unsqueeze(-2)
        shape = (*ahead.shape[:-1], 1)
        own, other = mass.unsqueeze(-2).expand(shape), mass.unsqueeze(-3).expand(shape)
        edge = [ahead, closing, own, other]
        node = [p, mass]
        if not self.factored:
            edge.append(coupling.unsqueeze(-1).expand(shape))
            node.append(coupling.expand(*p.shape[:-1], 1))
        messages = self.message(torch.cat(edge, -1))
        others = 1 - torch.eye(bodies, dtype=q.dtype, device=q.device).unsqueeze(-1)
        received = (others * messages).sum(-2)
        if self.factored:
            received = coupling * received
        out = self.update(torch.cat([*node, received], -1))
        return _halves(out)


def _halves(x: Tensor) -> PhaseState:
    """``(..., n, 2 d)`` as a state."""
    half = x.shape[-1] // 2
    return PhaseState(x[..., :half], x[..., half:])
