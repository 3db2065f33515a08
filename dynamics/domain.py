"""What states a learned model was trained on, and which others are far outside."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations

import torch
from jaxtyping import Float
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
FEW = 6  # bodies whose pairs are taken one by one
UNKNOWN = torch.inf  # nothing is known of training: no state is outside


def extents(state: PhaseState, box: float | None = None) -> Float[Tensor, "*b 4"]:
    """The largest |q_i|, |p_i|, |q_i - q_j| and 1 / |q_i - q_j| of each state, ``(..., 4)``.

    Args:
        state: ``(..., n, d)``.
        box: side of a periodic box, over which distances are taken.
    """
    batch, bodies = state.q.shape[:-2], state.q.shape[-2]
    if not bodies:
        return state.q.new_zeros(*batch, len(EXTENTS))
    nearest, farthest = state.q.new_full(batch, torch.inf), state.q.new_zeros(batch)
    for squared in _squared_distances(state.q, box):
        nearest = torch.minimum(nearest, squared.amin(-1))
        farthest = torch.maximum(farthest, squared.amax(-1))
    q, p = (_squared(x.unbind(-1)).amax(-1) for x in (state.q, state.p))
    return torch.stack([q, p, farthest, 1 / nearest], -1).sqrt()


def largest(state: PhaseState, names: Sequence[str], box: float | None = None) -> dict[str, float]:
    """The largest of some :func:`extents` over all states, at a fraction of the cost of each.

    Args:
        state: ``(..., n, d)``, at least one body.
        names: of :data:`EXTENTS`.
        box: side of a periodic box.
    """
    squares = dict.fromkeys(names, 0.0)
    for name, x in ((ORIGIN, state.q), (MOMENTUM, state.p)):
        if name in squares:
            squares[name] = float(_squared(x.unbind(-1)).amax())
    if FARTHEST in squares or NEAREST in squares:
        low, high = state.q.new_tensor(torch.inf), state.q.new_zeros(())
        for squared in _squared_distances(state.q, box):
            least, most = squared.aminmax()
            low, high = torch.minimum(low, least), torch.maximum(high, most)
        squares.update({FARTHEST: float(high), NEAREST: float(1 / low)})
    return {name: math.sqrt(squares[name]) for name in names}


def _squared_distances(q: Tensor, box: float | None) -> Iterator[Tensor]:
    """Of all pairs, some pairs at a time, ``(..., pairs)``."""
    nearest, columns, bodies = PairLaw(box=box).nearest, q.unbind(-1), q.shape[-2]
    if bodies <= FEW:  # whole rollouts are looked at: views, where an index would gather copies
        for i, j in combinations(range(bodies), 2):
            here, there = slice(i, i + 1), slice(j, j + 1)
            yield _squared([nearest(x[..., here] - x[..., there]) for x in columns])
        return
    for first, second in pair_tiles(bodies, q.shape[:-2].numel(), q.device):
        yield _squared(
            [nearest(x.index_select(-1, first) - x.index_select(-1, second)) for x in columns]
        )


def _squared(columns: Sequence[Tensor]) -> Tensor:
    """Sum of the squares of coordinates."""
    total = columns[0].square()
    for x in columns[1:]:
        total.addcmul_(x, x)
    return total
