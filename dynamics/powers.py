"""How the strength of a pair law goes with the coupling, of numbers, arrays and tensors alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def _linear(g: Any) -> Any:
    return g


def _quadratic(g: Any) -> Any:
    return g * g


def _cubic(g: Any) -> Any:
    return g * g * g


COUPLINGS: dict[str, Callable[[Any], Any]] = {
    "linear": _linear,
    "even": abs,
    "quadratic": _quadratic,
    "cubic": _cubic,
}
