"""From per-body channels back to positions: the centroid of a channel's light."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from renderers.camera import Camera


def centroids(
    frames: Float[Tensor, "*b n H W"], camera: Camera
) -> tuple[Float[Tensor, "*b n 2"], Float[Tensor, "*b n"]]:
    """Where each channel's light is centred, and how much light there is.

    Exact to rounding for a symmetric body that lies inside the frame; a body that the frame's edge
    cuts is pulled inwards (a Gaussian by more than 0.001 pixel nearer than 3.7 sigma to it).

    Args:
        frames: non-negative intensities.
        camera: the pixel grid that made them.

    Returns:
        Positions in world units, and mass: intensity integrated over the plane (world units
        squared). A black channel has position 0 and mass 0, which says that nothing was seen.

    Raises:
        ValueError: the frames' size is not the camera's, or a pixel is not finite.

    Example:
        >>> from renderers.worlds import ChannelWorld
        >>> camera = Camera()
        >>> q = torch.tensor([[1.0, -0.5]], dtype=torch.float64)
        >>> found, light = centroids(ChannelWorld(camera)(q), camera)
        >>> [round(x, 6) for x in found[0].tolist()]
        [1.0, -0.5]
    """
    if frames.shape[-2:] != (camera.height, camera.width):
        raise ValueError(
            f"centroids: frames of {tuple(frames.shape[-2:])} pixels (height, width) do not fit a "
            f"camera of {(camera.height, camera.width)}; pass the camera that rendered them"
        )
    total = frames.sum((-2, -1))
    if not bool(torch.isfinite(total).all()):
        where = tuple(torch.nonzero(~torch.isfinite(total))[0].tolist())
        raise ValueError(f"centroids: channel {where} has a pixel that is not finite; repair it")
    x = frames.sum(-2) @ camera.xs(frames.dtype, frames.device)
    y = frames.sum(-1) @ camera.ys(frames.dtype, frames.device)
    lit = total > 0
    positions = torch.stack([x, y], dim=-1) / torch.where(lit, total, 1).unsqueeze(-1)
    positions = torch.where(lit.unsqueeze(-1), positions, 0)
    return positions, total * camera.units_per_pixel**2
