"""Positions from a feature map: one heatmap per body, and where its heat is centred."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from readouts.base import FrameReadout

TEMPERATURE = 0.1


class SoftArgmax(FrameReadout):
    """A 1x1 convolution gives N heatmaps; a body is at the mean cell of its softmax.

    Args:
        channels: of the feature map.
        bodies: number of heatmaps.
        temperature: that the learned one starts at; lower is a more pointed heat.
    """

    def __init__(self, channels: int, bodies: int, temperature: float = TEMPERATURE) -> None:
        super().__init__()
        if not temperature > 0:
            raise ValueError(f"SoftArgmax: temperature must be positive, got {temperature}")
        self.project = nn.Conv2d(channels, bodies, 1)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(temperature)))

    def read(
        self, values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n"]]:
        """See :class:`readouts.base.Readout`."""
        return soft_argmax(self.project(values) * (-self.log_temperature).exp(), centres)


def soft_argmax(
    logits: Float[Tensor, "*b h w"], centres: Float[Tensor, "h w 2"]
) -> tuple[Float[Tensor, "*b 2"], Float[Tensor, "*b"]]:
    """The expected cell centre of a heatmap, differentiable, and how pointed the heat is.

    Confidence is 1 where all heat lies in one cell and 0 where every cell is alike: with the
    entropy S of the heat over m cells it is (m - e^S) / (m - 1), the share of the image that the
    heat leaves empty.

    Args:
        logits: of the heat; it is their softmax over the cells.
        centres: (x, y) of each cell, in the unit that the result is wanted in.

    Raises:
        ValueError: a logit is not finite.

    Example:
        >>> centres = torch.tensor([[[-0.5, 0.0], [0.5, 0.0]]])
        >>> position, sure = soft_argmax(torch.tensor([[0.0, 20.0]]), centres)
        >>> [round(x, 3) for x in position.tolist()], round(float(sure), 3)
        ([0.5, 0.0], 1.0)
    """
    if not bool(torch.isfinite(logits).all()):
        where = tuple(torch.nonzero(~torch.isfinite(logits))[0].tolist())
        raise ValueError(f"soft_argmax: logit {where} is not finite; its heat has no place")
    log_heat = logits.flatten(-2).log_softmax(-1)
    heat = log_heat.exp()
    cells = heat.shape[-1]
    position = heat @ centres.flatten(0, 1).to(heat)
    if cells == 1:
        return position, torch.ones_like(heat[..., 0])
    occupied = (-(heat * log_heat).sum(-1)).exp()
    return position, ((cells - occupied) / (cells - 1)).clamp(0, 1)
