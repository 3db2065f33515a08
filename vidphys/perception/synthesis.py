"""The renderer rung: which positions, drawn, give this frame? Nothing is learned.

Analysis through synthesis with the fixed differentiable renderer.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.func import jvp

from binders import Tracks
from renderers import ChannelWorld, centroids
from vidphys.data.clips import Clips
from vidphys.errors import InputError
from vidphys.perception.base import FitTask, Perception
from vidphys.placement import CPU, moved

CHUNK = 16  # clips at once
NARROW = 1e-12


@dataclass(frozen=True)
class SynthesisSettings:
    """Of the fit of positions.

    Args:
        rounds: of Levenberg-Marquardt, at most.
        settled: pixels; a smaller step ends the fit of a body.
        first_damping: of the normal equations.
    """

    rounds: int = 12
    settled: float = 1e-3
    first_damping: float = 1e-3


@dataclass(frozen=True)
class Synthesis:
    """Fits each frame's positions through the fixed differentiable renderer."""

    settings: SynthesisSettings = SynthesisSettings()
    device: str = "cpu"

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame; confidence is the share of light explained.

        Raises:
            InputError: the clips are of another world than one channel per body.
        """
        world = clips.world
        if not isinstance(world, ChannelWorld):
            raise InputError(
                f"renderer: fits a world of one channel per body, got {type(world).__name__}; "
                "render the clips in the channel world"
            )
        parts = []
        for start in range(0, len(clips), CHUNK):
            frames = clips.images(slice(start, start + CHUNK), self.device)
            parts.append(moved(fit_positions(world, frames, self.settings), CPU))
        positions, confidence = (torch.cat(x).double() for x in zip(*parts, strict=True))
        return Tracks(positions, confidence, clips.times)


def fit_synthesis(task: FitTask, settings: SynthesisSettings = SynthesisSettings()) -> Perception:
    """There is nothing to fit: the renderer is given."""
    return Synthesis(settings, task.device)


def fit_positions(
    world: ChannelWorld, frames: Tensor, settings: SynthesisSettings = SynthesisSettings()
) -> tuple[Tensor, Tensor]:
    """Positions whose rendering is nearest the frames, by Levenberg-Marquardt from the centroids.

    Bodies are in channels of their own, so each is a fit of two unknowns, and all are solved at
    once; a body whose step has become small is left alone, whatever the others still do.

    Args:
        world: draws positions.
        frames: ``(..., n, H, W)`` in [0, 1].

    Returns:
        World positions ``(..., n, 2)`` and confidence ``(..., n)``: one minus the residual's
        energy over the frame's, at least 0; 0 for a black channel.
    """
    q, light = centroids(frames, world.camera)
    damping = torch.full_like(light, settings.first_damping)
    cost = _cost(world, q, frames)
    moving, settled = light > 0, settings.settled * world.camera.units_per_pixel
    for _ in range(settings.rounds):
        if not bool(moving.any()):
            break
        step = _step(world, q, frames, damping)
        trial = _cost(world, q + step, frames)
        better = moving & (trial <= cost)
        q = torch.where(better.unsqueeze(-1), q + step, q)
        cost = torch.where(better, trial, cost)
        damping = torch.where(better, damping / 10, damping * 10)
        moving = moving & (step.abs().amax(-1) > settled)
    energy = frames.square().sum((-2, -1))
    explained = 1 - cost / torch.where(energy > 0, energy, 1)
    return q, torch.where(energy > 0, explained.clamp(0, 1), 0)


def _cost(world: ChannelWorld, q: Tensor, frames: Tensor) -> Tensor:
    return (world(q) - frames).square().sum((-2, -1))


def _step(world: ChannelWorld, q: Tensor, frames: Tensor, damping: Tensor) -> Tensor:
    """The damped Gauss-Newton step of each body, from the two images' derivatives."""
    drawn, dx = _derivative(world, q, 0)
    _, dy = _derivative(world, q, 1)
    residual = frames - drawn
    xx, yy, xy = (_dot(dx, dx), _dot(dy, dy), _dot(dx, dy))
    xx, yy = xx * (1 + damping) + NARROW, yy * (1 + damping) + NARROW
    bx, by = _dot(dx, residual), _dot(dy, residual)
    determinant = xx * yy - xy * xy
    return torch.stack([yy * bx - xy * by, xx * by - xy * bx], -1) / determinant.unsqueeze(-1)


def _derivative(world: ChannelWorld, q: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """The rendering, and its derivative as all bodies move along one axis."""
    direction = torch.zeros_like(q)
    direction[..., axis] = 1
    with warnings.catch_warnings():
        # Torch warns of itself where it first loads what forward derivatives need.
        warnings.simplefilter("ignore", FutureWarning)
        both: tuple[Tensor, Tensor] = jvp(world, (q,), (direction,))  # type: ignore[assignment]
    return both


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum((-2, -1))
