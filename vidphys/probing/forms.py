"""Forms of a feature map that a linear readout reads, and the choice among them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from vidphys.probing.controls import POOLED

CELLS, SOFTMAX = "cells", "softmax"
POINTED = 2.0  # a cell that speaks louder by a channel's deviation weighs e^2 times as much


def cells(maps: Tensor) -> Tensor:
    """All cells, as they are."""
    return maps


def pooled(maps: Tensor) -> Tensor:
    """The mean over all cells, as maps of one cell."""
    return maps.float().mean((-2, -1), keepdim=True)


def softmax(maps: Float[Tensor, "e c h w"]) -> Float[Tensor, "e c2 1 1"]:
    """Where each channel speaks: the mean cell of its softmax (Finn et al., arXiv:1509.06113).

    Example:
        >>> maps = torch.zeros(2, 1, 3, 3)
        >>> maps[0, 0, 0, 2], maps[1, 0, 2, 0] = 100, 100
        >>> softmax(maps).flatten(1).round().tolist()
        [[1.0, 1.0], [-1.0, -1.0]]
    """
    height, width = maps.shape[-2:]
    heat = (POINTED * standardised(maps)).flatten(-2).softmax(-1)
    down, right = (torch.linspace(-1, 1, n) if n > 1 else torch.zeros(1) for n in (height, width))
    places = torch.stack(torch.meshgrid(-down, right, indexing="ij")[::-1], -1).flatten(0, 1)
    return (heat @ places).flatten(1)[..., None, None]


FORMS: dict[str, Callable[[Tensor], Tensor]] = {CELLS: cells, POOLED: pooled, SOFTMAX: softmax}


def standardised(maps: Tensor) -> Tensor:
    """Channels of one spread, so that loud ones do not rule.

    One that hardly ever speaks is not magnified to noise.
    """
    channels = maps.float()
    deviation = channels.std((0, 2, 3), keepdim=True)
    floor = (0.1 * deviation.median()).clamp_min(1e-12)
    middle = channels.mean((0, 2, 3), keepdim=True)
    return (channels - middle) / torch.maximum(deviation, floor)


def at_places(
    maps: Float[Tensor, "e c h w"], places: Float[Tensor, "e n 2"]
) -> Float[Tensor, "e c n 1"]:
    """Features at places within the maps, between cells by the four around.

    Args:
        maps: of the examples.
        places: x and y of -1 to 1 over the image's width and height, y upwards.

    Example:
        >>> ramp = torch.arange(4.0).reshape(1, 1, 1, 4).expand(1, 1, 4, 4)
        >>> at_places(ramp, torch.tensor([[[0.0, 0.0], [0.25, 0.9]]])).flatten().tolist()
        [1.5, 2.0]
    """
    grid = places.float() * torch.tensor([1.0, -1.0])
    return functional.grid_sample(
        maps.float(), grid[:, :, None], padding_mode="border", align_corners=False
    )
