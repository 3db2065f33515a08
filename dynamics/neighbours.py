"""Pair potentials between near bodies only, for many bodies under laws that fall off."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.potentials import PairPotential
from dynamics.state import Parameters


class WithinReach(nn.Module):
    """A pair potential cut off at a distance, its pairs found by a k-d tree.

    phi is shifted to 0 at the cut-off, so that the energy has no step there; the force has one, and
    the energy of a rollout is conserved as well as that step is small. A law of finite range (a
    contact, a spring that breaks) loses nothing by a cut-off at its range.

    Args:
        whole: the potential of all pairs.
        reach: world units, > 0; in a periodic box less than half of its side.

    Raises:
        ValueError: such a reach is not given.
    """

    conservative = True

    def __init__(self, whole: PairPotential, reach: float) -> None:
        super().__init__()
        if not 0 < reach < float("inf"):
            raise ValueError(f"WithinReach: reach must be a positive distance, got {reach}")
        if whole.law.box is not None and reach >= whole.law.box / 2:
            raise ValueError(
                f"WithinReach: a reach of {reach:g} in a periodic box of {whole.law.box:g} meets a "
                "body and its image; use all pairs, or less than half of the box"
            )
        self.whole = whole
        self.reach = reach

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        strength, amount = self.whole.law.strength(params)
        edge = torch.zeros(q.shape[-1], dtype=q.dtype, device=q.device)
        edge[0] = self.reach
        shift = self.whole.pair_energy(edge)
        total = []
        for places, weight in self._episodes(q, amount):
            i, j, apart = self._near(places)
            phi = self.whole.pair_energy(apart) - shift
            total.append((weight[i] * weight[j] * phi).sum())
        return strength * torch.stack(total).reshape(q.shape[:-2])

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        strength, amount = self.whole.law.strength(params)
        total = []
        for places, weight in self._episodes(q, amount):
            i, j, apart = self._near(places)
            pull = (weight[i] * weight[j]).unsqueeze(-1) * self.whole.pair_gradient(apart)
            none = torch.zeros_like(places)
            total.append(none.index_add(0, i, pull, alpha=-1).index_add(0, j, pull))
        return strength[..., None, None] * torch.stack(total).reshape(q.shape)

    def _episodes(self, q: Tensor, amount: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        flat = amount.expand(q.shape[:-1]).reshape(-1, q.shape[-2])
        return zip(q.reshape(-1, *q.shape[-2:]), flat, strict=True)

    def _near(self, places: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Pairs within reach, each once, and their displacements."""
        from scipy.spatial import cKDTree

        known = places.detach().cpu().double().numpy()
        box = self.whole.law.box
        tree = cKDTree(known if box is None else known % box, boxsize=box)
        pairs = torch.from_numpy(tree.query_pairs(self.reach, output_type="ndarray"))
        i, j = pairs.to(places.device).unbind(-1)
        return i, j, self.whole.law.nearest(places[i] - places[j])
