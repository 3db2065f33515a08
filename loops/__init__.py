"""How loops over arrays are compiled for the processor, stored and shared among threads."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING

from registry import lazily

if TYPE_CHECKING:
    from loops.kernels import inlined as inlined
    from loops.kernels import kernel as kernel
    from loops.kernels import part as part
    from loops.kernels import summing as summing
    from loops.kernels import uncounted as uncounted
    from loops.streams import streaming as streaming
    from loops.threads import held_to as held_to
    from loops.threads import in_threads as in_threads

HOMES = {
    "held_to": "loops.threads",
    "in_threads": "loops.threads",
    "inlined": "loops.kernels",
    "part": "loops.kernels",
    "kernel": "loops.kernels",
    "streaming": "loops.streams",
    "summing": "loops.kernels",
    "uncounted": "loops.kernels",
}
__all__ = ["has_numba", "has_triton", *HOMES]
__getattr__, __dir__ = lazily(__name__, HOMES)


@lru_cache
def has_numba() -> bool:
    """Whether numba can be imported; without it everything runs as torch's operations."""
    return find_spec("numba") is not None


@lru_cache
def has_triton() -> bool:
    """Whether Triton can be imported, which compiles loops for a CUDA card."""
    return find_spec("triton") is not None
