"""The pairs of N bodies, as indices: all at once, or in tiles that bound the memory."""

from __future__ import annotations

from collections.abc import Iterator
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
