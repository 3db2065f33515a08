"""Cheaper ways to keep features, whose cost in what is read from them a probe measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

LEVELS = 127  # of 8 bits, on either side of zero
FEWER = 4  # cells on a side
SCALE_BYTES = 2  # of a channel's scale, which is a float16


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
    """Rounded to whole numbers of -127 to 127, with a scale for each channel of each example.

    Example:
        >>> maps = torch.tensor([[[[127.0, 31.6]], [[1270.0, 4.0]]]])  # one example, two channels
        >>> in_eight_bits(maps).flatten().tolist()
        [127.0, 32.0, 1270.0, 0.0]
    """
    scale = maps.float().abs().amax((-2, -1), keepdim=True) / LEVELS
    scale = scale.half().float().clamp_min(torch.finfo(torch.float16).tiny)
    return (maps.float() / scale).round().clamp(-LEVELS, LEVELS) * scale


def in_fewer_cells(maps: Float[Tensor, "e c h w"]) -> Float[Tensor, "e c h2 w2"]:
    """The mean over blocks of cells, :data:`FEWER` blocks on a side at most."""
    return functional.adaptive_avg_pool2d(maps.float(), _fewer(*maps.shape[-2:]))


def _fewer(height: int, width: int) -> tuple[int, int]:
    return min(height, FEWER), min(width, FEWER)


def _as_bytes(channels: int, height: int, width: int) -> int:
    return channels * (height * width + SCALE_BYTES)


KEPT = {
    keeping.name: keeping
    for keeping in (
        Keeping("int8", "8 bits, a scale for each channel", in_eight_bits, _as_bytes),
        Keeping(
            f"{FEWER}x{FEWER}",
            "the mean over blocks of cells, 16 bits",
            in_fewer_cells,
            lambda c, h, w: 2 * c * _fewer(h, w)[0] * _fewer(h, w)[1],
        ),
        Keeping(
            f"{FEWER}x{FEWER}-int8",
            "both",
            lambda maps: in_eight_bits(in_fewer_cells(maps)),
            lambda c, h, w: _as_bytes(c, *_fewer(h, w)),
        ),
    )
}
