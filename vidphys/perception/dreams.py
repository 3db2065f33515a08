"""Short clips that never were: bodies anywhere, drawn by the fixed renderer.

A detector that has seen nothing yet learns from dreams, whose positions are known because they
were made up (the sleep phase of Hinton et al. 1995); of the real clips they know only how far from
the middle there is light.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from vidphys.data.clips import Clips
from vidphys.perception.blobs import DrawnWorld
from vidphys.seeding import derive

MANY = 2**30  # dreams to choose from


@dataclass(frozen=True)
class Dream:
    """Windows of frames in [0, 1], ``(m, t, 1, H, W)``, and their positions, ``(m, t, n, 2)``."""

    frames: Tensor
    positions: Tensor


@dataclass(frozen=True)
class Dreams:
    """Bodies going straight from places that are normally distributed about the middle.

    Args:
        world: draws them.
        bodies: how many.
        spread: of the places along each axis, world units.
        length: frames of a dream.
        seed: of all of them.
        strides: world units a frame along each axis, standard deviation.
    """

    world: DrawnWorld
    bodies: int
    spread: float
    length: int
    seed: int
    strides: float = 0.1

    def __len__(self) -> int:
        return MANY

    def __getitem__(self, index: Tensor) -> Dream:
        rng = Generator().manual_seed(derive(self.seed, "dream", str(int(index[0]))))
        place, stride = torch.randn(2, len(index), 1, self.bodies, 2, generator=rng)
        frame = torch.arange(self.length)[:, None, None] - (self.length - 1) / 2
        positions = self.spread * place + self.strides * stride * frame
        # rounded to bytes, as clips are
        return Dream((self.world(positions) * 255).round() / 255, positions)


def light_spread(clips: Clips) -> float:
    """Root mean square distance of light from the middle along each axis, world units."""
    camera = clips.world.camera
    light = clips.frames.double().mean((0, 1, 2))
    squared = camera.ys().double()[:, None].square() + camera.xs().double().square()
    return float((light * squared).sum() / light.sum() / 2) ** 0.5
