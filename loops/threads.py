"""Work shared among as many threads as torch has been told to use, and their number for a while."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from typing import TypeVar

import torch

Found = TypeVar("Found")


def in_threads(
    part: Callable[[tuple[int, int]], Found], blocks: int, fewest: int = 1
) -> list[Found]:
    """``part(first, end)`` of the blocks for each thread that torch has been told to use.

    Args:
        part: of the work; may not share it in turn.
        blocks: of all work.
        fewest: blocks that are worth another thread, whose waking takes a tenth of a millisecond.
    """
    threads = max(1, min(torch.get_num_threads(), blocks // fewest))
    if threads == 1:
        return [part((0, blocks))]
    first, *others = pairwise(blocks * thread // threads for thread in range(threads + 1))
    pool = _kept(threads - 1, os.getpid())
    later = [pool.submit(part, which) for which in others]
    return [part(first), *(found.result() for found in later)]


@cache
def _kept(threads: int, process: int) -> ThreadPoolExecutor:
    """Threads that wait for work: to start one takes longer than it may have to do.

    Each process has its own, since a fork inherits none.
    """
    return ThreadPoolExecutor(threads)


@contextmanager
def held_to(count: int) -> Iterator[None]:
    """So many threads inside, and as many as before afterwards."""
    before = torch.get_num_threads()
    if count != before:  # to set what is set costs a microsecond that a small step would feel
        torch.set_num_threads(count)
    try:
        yield
    finally:
        if count != before:
            torch.set_num_threads(before)
