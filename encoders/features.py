"""What every encoder hands over: a feature map that knows its grid, stride and time stamps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class FeatureMap:
    """Features of a batch of clips on a regular grid.

    Args:
        values: ``(b, t, c, h, w)``; ``t`` counts feature frames, which a video encoder may have
            fewer of than the clip has frames.
        stride: pixels of the encoder's input image between neighbouring cells, (height, width).
        times: seconds, the centre of what each feature frame saw, ``(t,)``.

    Example:
        >>> features = FeatureMap(torch.zeros(1, 4, 8, 2, 2), (16.0, 16.0), torch.arange(4.0))
        >>> features.grid, features.cell_centres()[0, 0].tolist()  # top left cell: x left, y up
        ((2, 2), [-0.5, 0.5])
    """

    values: Float[Tensor, "b t c h w"]
    stride: tuple[float, float]
    times: Float[Tensor, " t"]

    @property
    def grid(self) -> tuple[int, int]:
        """Cells (height, width)."""
        return self.values.shape[-2], self.values.shape[-1]

    def cell_centres(self) -> Float[Tensor, "h w 2"]:
        """(x, y) of each cell's centre in normalised image units.

        The unit is half of the longer image side; the origin is the image centre, x grows to the
        right and y grows **upwards**.
        """
        h, w = self.grid
        sv, su = self.stride
        half = max(h * sv, w * su) / 2
        device = self.values.device
        x = ((torch.arange(w, device=device) + 0.5) * su - w * su / 2) / half
        y = (h * sv / 2 - (torch.arange(h, device=device) + 0.5) * sv) / half
        return torch.stack(torch.meshgrid(y, x, indexing="ij")[::-1], dim=-1)


@runtime_checkable
class Encoder(Protocol):
    """Frames in, feature map out. Implementations own their preprocessing."""

    def __call__(
        self, frames: Float[Tensor, "b t c h w"], times: Float[Tensor, " t"]
    ) -> FeatureMap:
        """Encode frames with values in [0, 1], taken at ``times`` (seconds)."""
        ...
