"""Pair potentials of long range among many bodies, far groups of them taken as one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.potentials import PairPotential
from dynamics.state import Parameters

LEAF = 4  # bodies at most in a group that is not divided
BLOCK = 1024  # bodies whose pairs are held at once


class BarnesHut(nn.Module):
    """A pair potential in which a far group of bodies acts from its centre (Barnes and Hut 1986).

    A group is one where its size over its distance is below the opening angle: N log N terms, not
    N^2 / 2. Forces are then no exact gradient of an energy, do not quite obey Newton's third law,
    and step where a group opens, so that a rollout conserves energy and momentum only as far as
    the angle is small. Groups of charges of both signs act by their sum alone, and need a smaller
    angle. ``vidphys trade`` measures the error.

    Args:
        whole: the potential of all pairs, in open space.
        angle: radians, in [0, 1]; 0 is all pairs.

    Raises:
        ValueError: such an angle is not given, or the potential's space is periodic.
    """

    conservative = False

    def __init__(self, whole: PairPotential, angle: float = 0.5) -> None:
        super().__init__()
        if not 0 <= angle <= 1:
            raise ValueError(f"BarnesHut: the opening angle must be in [0, 1], got {angle}")
        if whole.law.box is not None:
            raise ValueError("BarnesHut: a periodic box has no tree; use all pairs, or WithinReach")
        self.whole = whole
        self.angle = angle

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        strength, amount = self.whole.law.strength(params)
        total = []
        for places, weight in self._episodes(q, amount):
            parts = [
                (product * self.whole.pair_energy(apart)).sum()
                for _, apart, product in self._acting(places, weight)
            ]
            total.append(0.5 * torch.stack(parts).sum())
        return strength * torch.stack(total).reshape(q.shape[:-2])

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        strength, amount = self.whole.law.strength(params)
        total = []
        for places, weight in self._episodes(q, amount):
            force = torch.zeros_like(places)
            for body, apart, product in self._acting(places, weight):
                pull = product.unsqueeze(-1) * self.whole.pair_gradient(apart)
                force = force.index_add(0, body, pull, alpha=-1)
            total.append(force)
        return strength[..., None, None] * torch.stack(total).reshape(q.shape)

    def _episodes(self, q: Tensor, amount: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        flat = amount.expand(q.shape[:-1]).reshape(-1, q.shape[-2])
        return zip(q.reshape(-1, *q.shape[-2:]), flat, strict=True)

    def _acting(self, places: Tensor, weight: Tensor) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Bodies, their displacements from what acts on them, and both amounts' products."""
        tree = _Tree.over(places)
        centres, sums = tree.centres(places, weight)
        sources = torch.cat([centres, places])  # a body acts as a group of its own
        amounts = torch.cat([sums, weight])
        for block in torch.arange(len(places), device=places.device).split(BLOCK):
            body, source = tree.walk(block, places.detach(), centres.detach(), self.angle)
            yield body, places[body] - sources[source], weight[body] * amounts[source]


@dataclass(frozen=True)
class _Tree:
    """Groups of bodies, each a stretch ``[first, last)`` of their order; the first has them all.

    Args:
        order: of the bodies, ``(n,)``.
        first, last: of each group, ``(g,)``.
        parts: the two groups that a group is divided into, ``(g, 2)``; -1 where it is not.
        size: diagonal of each group's bounding box, world units, ``(g,)``.
    """

    order: Tensor
    first: Tensor
    last: Tensor
    parts: Tensor
    size: Tensor

    @classmethod
    def over(cls, places: Tensor) -> _Tree:
        """By medians along the longest side."""
        from scipy.spatial import cKDTree

        known = places.detach().cpu().double().numpy()
        tree = cKDTree(known, leafsize=LEAF)
        groups, parts = _listed(tree.tree)
        ends = np.array([(group.start_idx, group.end_idx) for group in groups])
        ordered = np.concatenate([known[tree.indices], known[:1]])  # reduceat asks for an end
        low, high = (
            least.reduceat(ordered, ends.ravel(), axis=0)[::2] for least in (np.minimum, np.maximum)
        )
        size = np.linalg.norm(high - low, axis=-1)
        told = (tree.indices, ends[:, 0], ends[:, 1], parts, size)
        return cls(*(torch.from_numpy(np.asarray(x)).to(places.device) for x in told))

    def centres(self, places: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        """Centres of the groups' amounts without their signs ``(g, d)``, and their sums ``(g,)``.

        By differences of running sums, in double precision, from the bodies' mean.
        """
        middle = places.detach().double().mean(0)
        w, x = weight.double()[self.order], places.double()[self.order] - middle
        columns = torch.cat([w[:, None], w.abs()[:, None], w.abs()[:, None] * x], -1)
        running = torch.cat([torch.zeros_like(columns[:1]), columns.cumsum(0)])
        told = running[self.last] - running[self.first]
        tiny = torch.finfo(torch.float64).tiny
        centres = middle + told[:, 2:] / told[:, 1:2].clamp_min(tiny)
        return centres.to(places.dtype), told[:, 0].to(places.dtype)

    def walk(
        self, bodies: Tensor, places: Tensor, centres: Tensor, angle: float
    ) -> tuple[Tensor, Tensor]:
        """Each body with what acts on it: groups, and bodies, which are counted after the groups.

        From the whole down, a level at a time: what is far is taken as one, a group that is not
        divided body by body, and any other by its parts.
        """
        body, group = bodies, torch.zeros_like(bodies)
        taken = []
        while len(body):
            distance = (places[body] - centres[group]).norm(dim=-1)
            far = self.size[group] < angle * distance
            taken.append((body[far], group[far]))
            body, group = body[~far], group[~far]
            whole = self.parts[group, 0] < 0
            taken.append(self._one_by_one(body[whole], group[whole]))
            body, group = body[~whole].repeat(2), self.parts[group[~whole]].T.reshape(-1)
        acted, sources = zip(*taken, strict=True)
        return torch.cat(acted), torch.cat(sources)

    def _one_by_one(self, body: Tensor, group: Tensor) -> tuple[Tensor, Tensor]:
        """Each body with every other one of its group."""
        count = self.last[group] - self.first[group]
        each = body.repeat_interleave(count)
        begun = (self.first[group] - count.cumsum(0) + count).repeat_interleave(count)
        other = self.order[begun + torch.arange(len(each), device=body.device)]
        apart = each != other
        return each[apart], len(self.size) + other[apart]


def _listed(root: Any) -> tuple[list[Any], np.ndarray]:
    """All nodes, and the places of each one's two parts among them."""
    nodes, parts, at = [root], [], 0
    while at < len(nodes):
        node = nodes[at]
        if node.lesser is None:
            parts.append((-1, -1))
        else:
            parts.append((len(nodes), len(nodes) + 1))
            nodes += [node.lesser, node.greater]
        at += 1
    return nodes, np.array(parts)
