"""The camera: where each pixel's centre lies in the world."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Camera:
    """A square-pixel view of the plane, centred on the world's origin, x right and y **up**.

    Pixel coordinates are (column, row) with whole numbers at pixel centres; row 0 is the top row
    and so has the largest y.

    Args:
        half_extent: world units from the centre to the edge along the longer image side.
        height: pixels.
        width: pixels.

    Raises:
        ValueError: ``half_extent`` is not positive and finite, or a side has no pixel.

    Example:
        >>> camera = Camera(half_extent=2.0, height=4, width=4)
        >>> camera.units_per_pixel
        1.0
        >>> camera.to_pixel(torch.tensor([0.5, 1.5])).tolist()  # column, row
        [2.0, 0.0]
    """

    half_extent: float = 4.0
    height: int = 64
    width: int = 64

    def __post_init__(self) -> None:
        if not (math.isfinite(self.half_extent) and self.half_extent > 0):
            raise ValueError(
                f"Camera: half_extent must be a positive number of world units, "
                f"got {self.half_extent}"
            )
        if self.height < 1 or self.width < 1:
            raise ValueError(
                f"Camera: height and width must be at least 1 pixel, "
                f"got {self.height} x {self.width}"
            )

    @property
    def units_per_pixel(self) -> float:
        """World units between neighbouring pixel centres, the same in x and y."""
        return 2 * self.half_extent / max(self.height, self.width)

    def xs(
        self, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
    ) -> Float[Tensor, " W"]:
        """World x of each column's centre, rising."""
        column = torch.arange(self.width, dtype=dtype, device=device)
        return (column - (self.width - 1) / 2) * self.units_per_pixel

    def ys(
        self, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
    ) -> Float[Tensor, " H"]:
        """World y of each row's centre, falling: row 0 is the top."""
        row = torch.arange(self.height, dtype=dtype, device=device)
        return ((self.height - 1) / 2 - row) * self.units_per_pixel

    def offsets(
        self, centres: Float[Tensor, "*b 2"]
    ) -> tuple[Float[Tensor, "*b W"], Float[Tensor, "*b H"]]:
        """World units from centres to columns and to rows; NaN for a centre that is not finite."""
        known = centres.nan_to_num(math.nan, math.nan, math.nan)
        across, down = (side(centres.dtype, centres.device) for side in (self.xs, self.ys))
        return across - known[..., 0:1], down - known[..., 1:2]

    def to_pixel(self, positions: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b 2"]:
        """World (x, y) to pixel (column, row)."""
        x, y = positions.unbind(-1)
        column = x / self.units_per_pixel + (self.width - 1) / 2
        row = (self.height - 1) / 2 - y / self.units_per_pixel
        return torch.stack([column, row], dim=-1)

    def to_world(self, pixels: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b 2"]:
        """Pixel (column, row) to world (x, y); the inverse of :meth:`to_pixel`."""
        column, row = pixels.unbind(-1)
        x = (column - (self.width - 1) / 2) * self.units_per_pixel
        y = ((self.height - 1) / 2 - row) * self.units_per_pixel
        return torch.stack([x, y], dim=-1)
