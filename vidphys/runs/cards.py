"""The cards of this machine, and which of them a process sees."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

SEEN = "CUDA_VISIBLE_DEVICES"


def cards() -> list[str]:
    """Those that this process may use, by the names by which another process is told of them."""
    told = os.environ.get(SEEN)
    if told is not None:
        return [name.strip() for name in told.split(",") if name.strip()]
    import torch

    return [str(number) for number in range(torch.cuda.device_count())]


def least_used(names: Sequence[str], used: Sequence[str | None]) -> str | None:
    """The card that the fewest use, the first of several; ``None`` where there is no card.

    Example:
        >>> least_used(["0", "1"], ["0", "1", "0"]), least_used([], [])
        ('1', None)
    """
    return min(names, key=used.count, default=None)


@contextmanager
def seeing(card: str | None) -> Iterator[None]:
    """A process that is started inside sees this card alone; all of them where it is ``None``."""
    before = os.environ.get(SEEN)
    if card is not None:
        os.environ[SEEN] = card
    try:
        yield
    finally:
        if before is not None:
            os.environ[SEEN] = before
        elif card is not None:
            del os.environ[SEEN]
