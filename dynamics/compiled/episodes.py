"""A batch of episodes as the loops take it: along one axis."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from dynamics.couplings import PairLaw
from dynamics.pairs import pair_indices
from dynamics.state import Parameters, PhaseState


class Episodes(NamedTuple):
    """What a backend rolls.

    Args:
        q, p: ``(episodes, bodies, 2)``.
        mass: ``(episodes, bodies)``.
        strength: c(G), ``(episodes,)``.
        amount: s_i, ``(episodes, bodies)``.
    """

    q: Tensor
    p: Tensor
    mass: Tensor
    strength: Tensor
    amount: Tensor

    @classmethod
    def of(cls, law: PairLaw, start: PhaseState, params: Parameters) -> Episodes:
        """Episodes of any batch, ``(..., n, d)``, under a law."""
        batch, sizes = start.q.shape[:-2], start.q.shape[-2:]
        strength, amount = law.strength(params)
        return cls(
            _flat(start.q, batch, *sizes),
            _flat(start.p, batch, *sizes),
            _flat(params.mass, batch, sizes[0]),
            _flat(strength, batch),
            _flat(amount, batch, sizes[0]),
        )


def _flat(x: Tensor, batch: torch.Size, *sizes: int) -> Tensor:
    """``x`` of every episode of a batch, along one axis: ``(episodes, *sizes)``."""
    if len(batch) == 1 and x.shape == (*batch, *sizes) and not x.requires_grad:
        return x
    return x.expand((*batch, *sizes)).reshape(-1, *sizes)


def told(law: PairLaw, params: Parameters, batch: torch.Size) -> Tensor:
    """1 / m of the bodies and c(G) s_i s_j of the pairs, ``(episodes, bodies + pairs)``."""
    strength, amount = law.strength(params)
    i, j = pair_indices(params.mass.shape[-1], params.mass.device)
    # By select: an index wakes torch's threads, which then spin where the loops' own want to run.
    product = strength.unsqueeze(-1) * (amount.index_select(-1, i) * amount.index_select(-1, j))
    wide = (x.expand(*batch, x.shape[-1]).reshape(-1, x.shape[-1]) for x in (params.mass, product))
    mass, product = (x.T.contiguous() for x in wide)
    return torch.cat([1 / mass, product]).T
