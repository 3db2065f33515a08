"""Cheaper ways to keep features, whose cost in what is read from them a probe measures.

They are those of a feature store: what is measured here is what `vidphys extract` then keeps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from encoders.arrays import bytes_kept, fewer_cells
from encoders.quantised import quantised

FEWER = 4  # cells on a side


@dataclass(frozen=True)
class Keeping:
    """One of them.

    Args:
        name: as it stands in records.
        about: what it is, in words.
        keep: maps ``(e, c, h, w)`` to what is read back of them.
        bytes: that an example of so many channels, rows and columns takes.
    """

    name: str
    about: str
    keep: Callable[[Tensor], Tensor]
    bytes: Callable[[int, int, int], int]


def in_eight_bits(maps: Float[Tensor, "e c h w"]) -> Float[Tensor, "e c h w"]:
    """As a feature store of int8 gives them back; see :mod:`encoders.quantised`."""
    return torch.from_numpy(quantised(maps.float().cpu().numpy()).numbers())


def in_fewer_cells(maps: Float[Tensor, "e c h w"]) -> Float[Tensor, "e c h2 w2"]:
    """The mean over blocks of cells, :data:`FEWER` blocks on a side at most."""
    return torch.from_numpy(fewer_cells(maps.float().cpu().numpy(), FEWER))


def _stored(dtype: str, most: int | None = None) -> Callable[[int, int, int], int]:
    """Bytes that a feature store has of an example, but for its file's header."""

    def size(channels: int, height: int, width: int) -> int:
        sides = (min(side, most or side) for side in (height, width))
        return bytes_kept((channels, *sides), dtype)

    return size


KEPT = {
    keeping.name: keeping
    for keeping in (
        Keeping(
            "int8", "8 bits, a scale and a mean for each channel", in_eight_bits, _stored("int8")
        ),
        Keeping(
            f"{FEWER}x{FEWER}",
            "the mean over blocks of cells, 16 bits",
            in_fewer_cells,
            _stored("float16", FEWER),
        ),
        Keeping(
            f"{FEWER}x{FEWER}-int8",
            "both",
            lambda maps: in_eight_bits(in_fewer_cells(maps)),
            _stored("int8", FEWER),
        ),
    )
}
