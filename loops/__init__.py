"""How loops over arrays are compiled for the processor, stored and shared among threads."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec


@lru_cache
def has_numba() -> bool:
    """Whether numba can be imported; without it everything runs as torch's operations."""
    return find_spec("numba") is not None
