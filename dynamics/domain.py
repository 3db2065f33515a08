"""What states a learned model was trained on, and which others are far outside."""

from __future__ import annotations

import torch
from torch import Tensor

from dynamics.couplings import PairLaw
from dynamics.pairs import pair_tiles
from dynamics.state import PhaseState

FAR = 3.0  # times the largest that was seen in training
ORIGIN, MOMENTUM, FARTHEST, NEAREST = EXTENTS = (
    "distance from the origin",
    "momentum",
    "distance between bodies",
    "nearness of bodies",
)
UNKNOWN = torch.inf  # nothing is known of training: no state is outside


def extents(state: PhaseState, box: float | None = None) -> Tensor:
    """The largest |q_i|, |p_i|, |q_i - q_j| and 1 / |q_i - q_j| of each state, ``(..., 4)``.

    Args:
        state: ``(..., n, d)``.
        box: side of a periodic box, over which distances are taken.
    """
    batch, bodies = state.q.shape[:-2], state.q.shape[-2]
    if not bodies:
        return state.q.new_zeros(*batch, len(EXTENTS))
    nearest, farthest = state.q.new_full(batch, torch.inf), state.q.new_zeros(batch)
    for i, j in pair_tiles(bodies, batch.numel(), state.q.device) if bodies > 1 else ():
        apart = state.q.index_select(-2, i) - state.q.index_select(-2, j)
        squared = PairLaw(box=box).nearest(apart).square().sum(-1)
        nearest = torch.minimum(nearest, squared.amin(-1))
        farthest = torch.maximum(farthest, squared.amax(-1))
    q, p = (x.square().sum(-1).amax(-1) for x in (state.q, state.p))
    return torch.stack([q, p, farthest, 1 / nearest], -1).sqrt()
