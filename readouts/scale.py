"""Standardising frozen features before a readout sees them."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

QUIET = 0.1  # of the channels' typical deviation: what is below it is magnified no further


class FeatureScale(nn.Module):
    """Standardises each channel by the statistics of the training features.

    A channel that hardly ever speaks in training counts as one of a tenth of the typical
    deviation, so that it does not drown all others when it speaks later.

    Args:
        channels: of the features.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(channels))
        self.register_buffer("deviation", torch.ones(channels))

    def fit(self, values: Float[Tensor, "f c h w"]) -> None:
        """Take the statistics of ``values``, over frames and cells."""
        # in float64: stored features may be half precision; one tensor for all: small ones,
        # kept between large ones that are not, would hold the memory of these
        moments = values.new_empty((2, len(values), values.shape[1]), dtype=torch.float64)
        for frame, value in enumerate(values):
            wide = value.double()
            torch.mean(wide, (1, 2), out=moments[0, frame])
            torch.mean(wide.square(), (1, 2), out=moments[1, frame])
        mean, square = moments.mean(1)
        self.mean.copy_(mean)
        variance = (square - mean**2).clamp_min(0)
        floor = QUIET**2 * variance.mean()
        self.deviation.copy_(torch.maximum(variance, floor).clamp_min(1e-12).sqrt())

    def forward(self, tokens: Float[Tensor, "*batch c"]) -> Float[Tensor, "*batch c"]:
        return (tokens.to(self.mean.dtype) - self.mean) / self.deviation
