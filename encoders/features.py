"""What every encoder hands over: a feature map that knows its grid, stride and time stamps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from encoders.grid import size_of, stride_of

# that a feature store keeps
DTYPES = {"float16": torch.float16, "bfloat16": torch.bfloat16, "float32": torch.float32}


@dataclass(frozen=True)
class FeatureMap:
    """Features of a batch of clips on a regular grid.

    Args:
        values: ``(b, t, c, h, w)``; ``t`` counts feature frames, which a video encoder may have
            fewer of than the clip has frames.
        stride: pixels of the encoder's input image between neighbouring cells, (height, width).
            Where the grid leaves out a border of the image, its pixels follow: above (and below),
            and left (and right).
        times: seconds, the centre of what each feature frame saw, ``(t,)``.

    Example:
        >>> features = FeatureMap(torch.zeros(1, 4, 8, 2, 2), (16.0, 16.0), torch.arange(4.0))
        >>> features.grid, features.cell_centres()[0, 0].tolist()  # top left cell: x left, y up
        ((2, 2), [-0.5, 0.5])
    """

    values: Float[Tensor, "b t c h w"]
    stride: tuple[float, ...]
    times: Float[Tensor, " t"]

    @property
    def grid(self) -> tuple[int, int]:
        """Cells (height, width)."""
        return self.values.shape[-2], self.values.shape[-1]

    def cell_centres(self) -> Float[Tensor, "h w 2"]:
        """(x, y) of each cell's centre in normalised image units.

        The unit is half of the longer side of the whole image; the origin is the image centre, x
        grows to the right and y grows **upwards**.
        """
        h, w = self.grid
        sv, su = self.stride[:2]
        half = max(size_of(self.stride, self.values.shape)) / 2
        device = self.values.device
        x = ((torch.arange(w, device=device) + 0.5) * su - w * su / 2) / half
        y = (h * sv / 2 - (torch.arange(h, device=device) + 0.5) * sv) / half
        return torch.stack(torch.meshgrid(y, x, indexing="ij")[::-1], dim=-1)


@dataclass(frozen=True)
class FeatureStream:
    """Features of one clip as they are made, for clips that are too long to be held.

    Args:
        layers: that come from one pass.
        pieces: ``(f, c, h, w)`` of each layer, one after the other; ``f`` adds up to
            ``len(times)``.
        size: of the frames in pixels, (height, width), with the border that the features leave out.
        times: as those of a :class:`FeatureMap`.
    """

    layers: tuple[str, ...]
    pieces: Iterator[Sequence[Tensor]]
    size: tuple[int | float, int | float]
    times: Float[Tensor, " t"]

    def whole(self) -> dict[str, FeatureMap]:
        """All of them, by layer."""
        kept: list[list[Tensor]] = [[] for _ in self.layers]
        for piece in self.pieces:
            for some, values in zip(kept, piece, strict=True):
                some.append(values)
        joined = (torch.cat(some)[None] for some in kept)
        return {
            layer: FeatureMap(values, stride_of(self.size, values.shape), self.times)
            for layer, values in zip(self.layers, joined, strict=True)
        }


def streamed(layer: str, features: FeatureMap) -> FeatureStream:
    """Features of one clip that are there already, as a stream.

    Raises:
        ValueError: more than one clip.
    """
    if len(features.values) != 1:
        raise ValueError(f"features: one clip at a time, got a batch of {len(features.values)}")
    pieces = ([values] for values in features.values)
    size = size_of(features.stride, features.values.shape)
    return FeatureStream((layer,), pieces, size, features.times)


@runtime_checkable
class Encoder(Protocol):
    """Frames in, feature map out. Implementations own their preprocessing."""

    def __call__(
        self, frames: Float[Tensor, "b t c h w"], times: Float[Tensor, " t"]
    ) -> FeatureMap:
        """Encode frames with values in [0, 1], taken at ``times`` (seconds)."""
        ...
