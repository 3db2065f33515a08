"""Worlds: how positions become frames. Each is a function from positions to images in [0, 1].

In every world a body out of the frame leaves its tail or nothing, and frames without bodies are
black. They differ in what is left of identity: a channel, a colour, or nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from renderers.camera import Camera
from renderers.splats import disk_coverage, disks, gaussians

PALETTE = (
    (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, 0.0, 1.0),
    (1.0, 1.0, 0.0),
    (1.0, 0.0, 1.0),
    (0.0, 1.0, 1.0),
)
SOFTNESS = 0.05


@dataclass(frozen=True)
class ChannelWorld:
    """One channel per body, a Gaussian of peak 1: identity is given (the study's renderer anchor).

    Overlapping bodies do not hide one another. Zero bodies give zero channels.

    Args:
        camera: the pixel grid.
        sigma: standard deviation of a body, world units.

    Example:
        >>> tuple(ChannelWorld()(torch.zeros(5, 3, 2)).shape)  # frames, bodies, height, width
        (5, 3, 64, 64)
    """

    camera: Camera = Camera()
    sigma: float = 0.25

    def __call__(self, q: Float[Tensor, "*b n 2"]) -> Float[Tensor, "*b n H W"]:
        """Frames of bodies at ``q`` (world units); ValueError names a body that is not finite."""
        return gaussians(q, self.camera, self.sigma)


@dataclass(frozen=True)
class RgbWorld:
    """Coloured disks over black: identity is the colour, and nearer bodies hide farther ones.

    Depth is fixed by index: body 0 is nearest, and each is composited over those behind it.

    Args:
        camera: the pixel grid.
        radius: of a disk, world units.
        softness: of its edge, world units.
        palette: (r, g, b) in [0, 1] of each body; more colours than bodies is fine.

    Example:
        >>> frame = RgbWorld(Camera(height=9, width=9))(torch.zeros(2, 2))  # red before green
        >>> [round(x, 2) for x in frame[:, 4, 4].tolist()]
        [0.97, 0.03, 0.0]
    """

    camera: Camera = Camera()
    radius: float = 0.35
    softness: float = SOFTNESS
    palette: tuple[tuple[float, float, float], ...] = PALETTE

    def __call__(self, q: Float[Tensor, "*b n 2"]) -> Float[Tensor, "*b 3 H W"]:
        """Frames of bodies at ``q`` (world units).

        Raises:
            ValueError: a body is not finite (its index is named), or has no colour.
        """
        bodies = q.shape[-2]
        if bodies > len(self.palette):
            raise ValueError(
                f"RgbWorld: {bodies} bodies but a palette of {len(self.palette)} colours; "
                "pass a palette with a colour for each body"
            )
        coverage = disks(q, self.camera, self.radius, self.softness)
        colours = coverage.new_tensor(self.palette)[:bodies].reshape(bodies, 3)
        return torch.einsum("...nhw,nc->...chw", _visible(coverage), colours)


@dataclass(frozen=True)
class AnonymousWorld:
    """All bodies white in one channel: no identity (the study's anonymous world).

    Where bodies overlap the light is 1 - prod(1 - coverage), so order does not matter.

    Args:
        camera: the pixel grid.
        radius: of a disk, world units.
        softness: of its edge, world units.

    Example:
        >>> frames = AnonymousWorld()(torch.tensor([[-1.0, 0.0], [1.0, 0.0]]))
        >>> tuple(frames.shape), torch.allclose(frames, frames.flip(-1))
        ((1, 64, 64), True)
    """

    camera: Camera = Camera()
    radius: float = 0.6
    softness: float = SOFTNESS

    def __call__(self, q: Float[Tensor, "*b n 2"]) -> Float[Tensor, "*b 1 H W"]:
        """Frames of bodies at ``q`` (world units); ValueError names a body that is not finite."""
        dark = 1 - disks(q, self.camera, self.radius, self.softness)
        return 1 - dark.prod(-3, keepdim=True)

    def coverage(self, squared: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
        """Light of one body at a squared distance (world units squared) from its centre."""
        return disk_coverage(squared, self.radius, self.softness)


World = ChannelWorld | RgbWorld | AnonymousWorld
WORLDS: dict[str, Callable[..., World]] = {
    "channel": ChannelWorld,
    "rgb": RgbWorld,
    "anonymous": AnonymousWorld,
}


def _visible(coverage: Tensor) -> Tensor:
    """How much of each body, ``(..., n, H, W)``, the nearer ones leave visible."""
    clear, visible = torch.ones_like(coverage[..., :1, :, :]), []
    for body in coverage.split(1, dim=-3) if coverage.shape[-3] else ():
        visible.append(clear * body)
        clear = clear * (1 - body)
    return torch.cat(visible, dim=-3) if visible else coverage
