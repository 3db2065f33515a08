"""The trained convolutional encoder, of the pixel and JEPA rungs."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from encoders.features import FeatureMap

STRIDE = 2.0
DEEPEST = 16  # pixels between neighbouring cells of the coarsest level


class ConvEncoder(nn.Module):
    """Frames to a fine feature map: a trunk down to stride 16 and a light path back to stride 2.

    Nearly all parameters (386k at three channels; the study has 383k) sit where the grid is small
    and cheap; the way back up is 1x1 projections and additions, so that the finest level knows
    what lies around it and still says where, to a small fraction of a cell.

    Args:
        channels: of the frames.
        features: channels of the feature map.
        widths: channels of the trunk at strides 2, 4, 8, 16 and, once more, 16.

    Example:
        >>> frames, times = torch.zeros(1, 2, 3, 32, 32), torch.tensor([0.0, 0.1])
        >>> features = ConvEncoder(channels=3)(frames, times)
        >>> tuple(features.values.shape), features.stride
        ((1, 2, 16, 16, 16), (2.0, 2.0))
    """

    def __init__(
        self,
        channels: int,
        features: int = 16,
        widths: tuple[int, int, int, int, int] = (32, 48, 96, 144, 152),
    ) -> None:
        super().__init__()
        self.channels = channels
        *halving, last = widths
        # The first window is 4 wide, so that it is centred on its cell as the others need not be.
        self.trunk = nn.ModuleList(
            nn.Sequential(nn.Conv2d(i, o, k, stride=2, padding=1), nn.SiLU())
            for i, o, k in zip((channels, *halving), halving, (4, 3, 3, 3), strict=False)
        )
        self.deepest = nn.Sequential(nn.Conv2d(halving[-1], last, 3, padding=1), nn.SiLU())
        self.lateral = nn.ModuleList(nn.Conv2d(w, features, 1) for w in (*halving[:-1], last))
        self.mix = nn.Sequential(nn.SiLU(), nn.Conv2d(features, features, 3, padding=1))
        self.to(memory_format=torch.channels_last)  # a quarter faster on a CPU

    def forward(self, frames: Float[Tensor, "b t c h w"], times: Float[Tensor, " t"]) -> FeatureMap:
        """Encode each frame by itself.

        Args:
            frames: values in [0, 1]; height and width are multiples of 16 pixels.
            times: seconds of each frame.

        Raises:
            ValueError: another number of channels, or a side that is not a multiple of 16.
        """
        b, t, c, h, w = frames.shape
        if c != self.channels:
            raise ValueError(
                f"ConvEncoder: built for frames of {self.channels} channels, got {c}; build it "
                "with the world's number of channels"
            )
        if h % DEEPEST or w % DEEPEST:
            raise ValueError(
                f"ConvEncoder: height and width must be multiples of {DEEPEST} pixels, got "
                f"{h} x {w}; render or resize to such a size"
            )
        values = self._encode(_compress(frames.flatten(0, 1)))
        return FeatureMap(values.unflatten(0, (b, t)), (float(STRIDE), float(STRIDE)), times)

    def _encode(self, x: Tensor) -> Tensor:
        levels = []
        for stage in self.trunk:
            x = stage(x)
            levels.append(x)
        levels[-1] = self.deepest(x)
        up = self.lateral[-1](levels[-1])
        for level, lateral in zip(levels[-2::-1], list(self.lateral)[-2::-1], strict=True):
            up = functional.interpolate(up, scale_factor=2.0, mode="bilinear") + lateral(level)
        return up + self.mix(up)


def _compress(frames: Tensor) -> Tensor:
    """Intensity on a logarithmic scale from 0 to 1, one byte level being the unit near black.

    A body's flank then falls off over many pixels instead of a few, which is what a fine position
    is read from.
    """
    return (255 * frames).log1p() / math.log(256)
