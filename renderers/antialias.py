"""Supersampling: what a pixel's whole area sees, in place of its centre."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import avg_pool2d

from renderers.worlds import World


def supersampled(
    world: World, factor: int
) -> Callable[[Float[Tensor, "*b n 2"]], Float[Tensor, "*b c H W"]]:
    """A world whose pixels are the mean of ``factor`` x ``factor`` samples of their area.

    Args:
        world: draws at the pixels' centres.
        factor: samples along each side of a pixel; 1 gives the world itself.

    Raises:
        ValueError: ``factor`` is less than 1.

    Example:
        >>> import torch
        >>> from renderers.worlds import AnonymousWorld
        >>> fine = supersampled(AnonymousWorld(), factor=3)
        >>> tuple(fine(torch.zeros(1, 2)).shape)
        (1, 64, 64)
    """
    if factor < 1:
        raise ValueError(f"supersampled: factor must be at least 1, got {factor}")
    if factor == 1:
        return world
    camera = world.camera
    fine = replace(camera, height=factor * camera.height, width=factor * camera.width)
    finer = replace(world, camera=fine)

    def draw(q: Tensor) -> Tensor:
        frames = finer(q)
        flat = frames.flatten(0, -3) if frames.dim() > 3 else frames
        return avg_pool2d(flat, factor).unflatten(0, frames.shape[:-2])

    return draw
