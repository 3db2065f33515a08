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
SCALE_BYTES, MEAN_BYTES = 2, 4  # of a channel's scale and mean, a float16 and a float32


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
    """Rounded to 8 bits around each channel's mean over cells, which stays as it is.

    Motion lies in small changes of that mean, below a step of the loudest cell. So what is kept
    beside the bits is the mean less that of the bits: together they give the true mean, whatever
    was rounded.

    Example:
        >>> maps = torch.tensor([[[[227.0, 131.6, 40.4, 1.0]]]])  # one channel, of mean 100
        >>> kept = in_eight_bits(maps)
        >>> [round(x, 1) for x in kept.flatten().tolist()], round(float(kept.mean()), 4)
        ([227.0, 132.0, 40.0, 1.0], 100.0)
    """
    whole = maps.float()
    apart = whole - whole.mean((-2, -1), keepdim=True)
    scale = apart.abs().amax((-2, -1), keepdim=True) / LEVELS
    scale = scale.half().float().clamp_min(torch.finfo(torch.float16).tiny)
    bits = (apart / scale).round().clamp(-LEVELS, LEVELS) * scale
    return bits + (whole - bits).mean((-2, -1), keepdim=True)


def in_fewer_cells(maps: Float[Tensor, "e c h w"]) -> Float[Tensor, "e c h2 w2"]:
    """The mean over blocks of cells, :data:`FEWER` blocks on a side at most."""
    return functional.adaptive_avg_pool2d(maps.float(), _fewer(*maps.shape[-2:]))


def _fewer(height: int, width: int) -> tuple[int, int]:
    return min(height, FEWER), min(width, FEWER)


def _as_bytes(channels: int, height: int, width: int) -> int:
    return channels * (height * width + SCALE_BYTES + MEAN_BYTES)


KEPT = {
    keeping.name: keeping
    for keeping in (
        Keeping("int8", "8 bits, a scale and a mean for each channel", in_eight_bits, _as_bytes),
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
