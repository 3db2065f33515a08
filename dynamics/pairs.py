"""The pairs of N bodies, as indices or in blocks: all at once, or in parts that bound memory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

MOST_PAIRS = 2**24  # at once: a quarter of a gigabyte of indices


@lru_cache(maxsize=64)
def pair_indices(bodies: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Indices (i, j) of the pairs i < j, each ``(bodies * (bodies - 1) / 2,)``.

    Raises:
        ValueError: too many to be held at once.
    """
    if bodies * (bodies - 1) // 2 > MOST_PAIRS:
        raise ValueError(
            f"pairs: {bodies} bodies make {bodies * (bodies - 1) // 2:,} pairs, more than the "
            f"{MOST_PAIRS:,} that a term which needs them all at once can hold; use fewer bodies"
        )
    # The cache outlives the caller: a tensor born in inference mode could not be trained through.
    with torch.inference_mode(False):
        i, j = torch.triu_indices(bodies, bodies, offset=1, device=device)
    return i, j


TILE = 2**20  # pairs times episodes at once: displacements of 16 megabytes
FEW = 2**12  # pairs that are never taken apart, however many the episodes


def pair_tiles(bodies: int, batch: int, device: torch.device) -> Iterator[tuple[Tensor, Tensor]]:
    """The pairs i < j, all at once where they are few, else some bodies' at a time.

    Args:
        bodies: number of bodies.
        batch: episodes that are computed together.
        device: of the indices.
    """
    pairs = bodies * (bodies - 1) // 2
    if pairs <= FEW or pairs * batch <= TILE:
        yield pair_indices(bodies, device)
        return
    rows = max(1, TILE // (bodies * batch))
    for begin in range(0, bodies - 1, rows):
        here = min(rows, bodies - 1 - begin)
        i, j = torch.triu_indices(here, bodies - begin, offset=1, device=device)
        yield i + begin, j + begin


SIDE = 128  # bodies of a block's side at most: its pairs then stay in a core's cache


@dataclass(frozen=True)
class Listed:
    """Pairs by the indices of both bodies, each ``(pairs,)``."""

    first: Tensor
    second: Tensor

    def difference(self, q: Tensor) -> Tensor:
        """``q_i - q_j`` of places ``(..., n, d)``, ``(..., pairs, d)``."""
        return q.index_select(-2, self.first) - q.index_select(-2, self.second)

    def product(self, amount: Tensor) -> Tensor:
        """``s_i s_j`` of amounts ``(..., n)``, ``(..., pairs)``."""
        return amount.index_select(-1, self.first) * amount.index_select(-1, self.second)

    def added(self, force: Tensor, pull: Tensor) -> Tensor:
        """Forces ``(..., n, d)`` with what each pair ``(..., pairs, d)`` does to both bodies."""
        return force.index_add(-2, self.first, pull, alpha=-1).index_add(-2, self.second, pull)


@dataclass(frozen=True)
class Block:
    """Every one of some bodies with every one of later ones, which needs no index.

    The methods are those of :class:`Listed`; forces are added in place.
    """

    rows: slice
    columns: slice

    def difference(self, q: Tensor) -> Tensor:
        apart = q[..., self.rows, None, :] - q[..., None, self.columns, :]
        return apart.flatten(-3, -2)

    def product(self, amount: Tensor) -> Tensor:
        return (amount[..., self.rows, None] * amount[..., None, self.columns]).flatten(-2)

    def added(self, force: Tensor, pull: Tensor) -> Tensor:
        rows, columns = force[..., self.rows, :], force[..., self.columns, :]
        each = pull.unflatten(-2, (rows.shape[-2], columns.shape[-2]))
        rows -= each.sum(-2)
        columns += each.sum(-3)
        return force


def pair_groups(bodies: int, batch: int, device: torch.device) -> Iterator[Listed | Block]:
    """The pairs i < j, all in a list where they are few, else mostly in blocks.

    Args:
        bodies: number of bodies.
        batch: episodes that are computed together.
        device: of the indices.
    """
    if bodies * (bodies - 1) // 2 <= FEW:
        yield Listed(*pair_indices(bodies, device))
        return
    side = max(1, min(SIDE, math.isqrt(TILE // batch)))
    starts = range(0, bodies, side)
    for begin in starts:
        here = slice(begin, min(begin + side, bodies))
        i, j = pair_indices(here.stop - begin, device)
        yield Listed(i + begin, j + begin)
        for other in starts[begin // side + 1 :]:
            yield Block(here, slice(other, min(other + side, bodies)))
