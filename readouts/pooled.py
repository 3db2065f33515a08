"""The pooled control: the same budget, without looking anywhere in particular."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from readouts.base import FrameReadout
from readouts.scale import FeatureScale


class PooledReadout(FrameReadout):
    """Mean over the cells of one frame, then a two-layer network to N positions.

    Args:
        channels: of the feature map.
        bodies: number of positions.
        width: of the hidden layers.
    """

    def __init__(self, channels: int, bodies: int, width: int) -> None:
        super().__init__()
        self.bodies = bodies
        self.scale = FeatureScale(channels)
        self.network = nn.Sequential(
            nn.Linear(channels, width),
            nn.GELU(),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Linear(width, 2 * bodies),
        )

    def fit_scale(self, values: Float[Tensor, "f c h w"]) -> None:
        """Standardise pooled features from now on by the statistics of these."""
        pooled = torch.empty(values.shape[:2], device=values.device)
        for frame, value in enumerate(values):
            torch.mean(value.float(), (-2, -1), out=pooled[frame])
        self.scale.fit(pooled[..., None, None])

    def read(
        self, values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n"]]:
        """See :class:`readouts.base.Readout`; here the confidence is 1, centres are not used."""
        pooled = self.scale(values.float().mean((-2, -1)))
        positions = self.network(pooled).unflatten(-1, (self.bodies, 2))
        return positions, torch.ones_like(positions[..., 0])


def pooled_twin(readout: nn.Module, channels: int, bodies: int) -> PooledReadout:
    """The pooled readout that has as nearly as possible as many parameters as ``readout``.

    Example:
        >>> from readouts.attention import AttentionReadout
        >>> readout = AttentionReadout(channels=16, bodies=3, width=32)
        >>> twin = pooled_twin(readout, channels=16, bodies=3)
        >>> sizes = [sum(p.numel() for p in m.parameters()) for m in (readout, twin)]
        >>> abs(sizes[0] / sizes[1] - 1) < 0.02
        True
    """
    budget = sum(p.numel() for p in readout.parameters())
    # width^2 + (channels + 2 + 2 bodies) width + 2 bodies = budget
    linear = channels + 2 + 2 * bodies
    width = (math.sqrt(linear**2 + 4 * (budget - 2 * bodies)) - linear) / 2
    return PooledReadout(channels, bodies, max(1, round(width)))
