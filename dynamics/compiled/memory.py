"""Memory for what a way forward keeps for its way back, used again once it is let go."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.compiled.lanes import Array

MOST_SPARE = 2**28  # bytes
_spare: dict[tuple[Any, ...], list[Array]] = {}


class Kept:
    """An array, not initialised; fresh memory of this size costs a tenth of a training step.

    Args:
        shape, dtype: of the array.

    Attributes:
        array: it.
    """

    def __init__(self, shape: tuple[int, ...], dtype: Any) -> None:
        self.key = (shape, dtype)
        spare = _spare.get(self.key)
        self.array = spare.pop() if spare else np.empty(shape, dtype)

    def __del__(self) -> None:
        held = sum(array.nbytes for arrays in list(_spare.values()) for array in arrays)
        if held + self.array.nbytes > MOST_SPARE:
            _spare.clear()
        _spare.setdefault(self.key, []).append(self.array)
