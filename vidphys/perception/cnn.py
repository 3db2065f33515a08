"""The trained CNN with soft-argmax, and its supervised rung."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor, nn

from binders import Tracks
from dynamics import Head
from encoders.cnn import ConvEncoder
from readouts.soft_argmax import SoftArgmax
from renderers import Camera
from vidphys.data.clips import Clips
from vidphys.errors import InputError
from vidphys.perception.base import FitTask, Perception
from vidphys.perception.windows import FrameBatches
from vidphys.placement import CPU, device_of, moved
from vidphys.seeding import derive
from vidphys.training.loop import Batches, FitSettings, fit

CHUNK = 16  # clips encoded at once


@dataclass(frozen=True)
class CnnSettings:
    """Of the encoder and its supervised training.

    Args:
        features: channels of the feature map.
        learning_rate: 1e-2 is now and then too fast: the heat ends in one cell and stays.
        clip: largest gradient norm.
        fine: pixels; errors below it count as squares, errors above it as their logarithm.
    """

    features: int = 16
    learning_rate: float = 6e-3
    clip: float = 0.3
    fine: float = 0.1


class CnnPerception(nn.Module):
    """Frames through the trained encoder and soft-argmax; identity is the heatmap's number.

    One that was trained together with a dynamics head has that as ``head``.

    Args:
        channels: of the frames.
        bodies: to be found.
        camera: of the frames.
        features: channels of the feature map.
    """

    head: Head

    def __init__(
        self, channels: int, bodies: int, camera: Camera, features: int = CnnSettings.features
    ) -> None:
        super().__init__()
        self.camera = camera
        self.encoder = ConvEncoder(channels, features)
        self.readout = SoftArgmax(features, bodies)

    def forward(self, frames: Tensor, times: Tensor) -> tuple[Tensor, Tensor]:
        """World positions ``(b, t, n, 2)`` and confidence ``(b, t, n)`` of frames in [0, 1]."""
        positions, confidence = self.readout(self.encoder(frames, times))
        return self.camera.half_extent * positions, confidence

    def locate(self, frames: Tensor) -> Tensor:
        """World positions alone; the encoder sees each frame by itself, whenever it was."""
        return self(frames, torch.zeros(frames.shape[1], device=frames.device))[0]

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame.

        Raises:
            InputError: the clips were seen by another camera than the training clips.
        """
        if clips.world.camera != self.camera:
            raise InputError(
                f"cnn: fitted to frames of {self.camera}, got {clips.world.camera}; "
                "render the clips with the same camera, or fit again"
            )
        times, device = clips.times, device_of(self)
        with torch.inference_mode():
            parts = [
                moved(self(clips.images(slice(start, start + CHUNK), device), times), CPU)
                for start in range(0, len(clips), CHUNK)
            ]
            positions, confidence = (torch.cat(x) for x in zip(*parts, strict=True))
        # Copies, because inference tensors may not be used in a later training.
        return Tracks(positions.double(), confidence.double(), times)


P = TypeVar("P", bound=CnnPerception)


def fit_supervised(task: FitTask, settings: CnnSettings = CnnSettings()) -> Perception:
    """Train on true positions: the rung that asks nothing of perception but capacity."""
    perception = new_perception(task, "cnn-supervised", CnnPerception, settings.features)
    frames = task.clips.frames.flatten(0, 1)
    data = FrameBatches(frames, task.clips.states.q.flatten(0, 1).float())
    fine = settings.fine * perception.camera.units_per_pixel

    def loss(batch: tuple[Tensor, Tensor]) -> Tensor:
        images, targets = batch
        return position_loss(perception.locate(images).squeeze(1) - targets, fine)

    steps, batch = task.sizes.perception_steps, task.sizes.perception_batch
    how = FitSettings(steps, batch, settings.learning_rate, settings.clip)
    train(task, "cnn-supervised", perception, loss, data, how)
    return perception.eval()


def position_loss(error: Tensor, fine: float) -> Tensor:
    """log(1 + (e / fine)^2), averaged: coarse errors first, and no end to the fine ones.

    Args:
        error, fine: world units.
    """
    return (error / fine).square().log1p().mean()


def new_perception(task: FitTask, name: str, kind: type[P], features: int) -> P:
    """An untrained perception of the task's frames; ``name`` separates the random streams."""
    torch.manual_seed(derive(task.seed, "init", name))
    channels, bodies = task.clips.frames.shape[2], task.clips.params.mass.shape[-1]
    return kind(channels, bodies, task.clips.world.camera, features).to(task.device)


def train(
    task: FitTask,
    name: str,
    modules: nn.Module,
    loss: Callable[..., Tensor],
    data: Batches,
    settings: FitSettings,
) -> None:
    """Fit ``modules``; with a folder, resumable, from a checkpoint of this name and seed."""
    save_to = None if task.folder is None else task.folder / f"{name}-seed{task.seed}.json"
    fit(modules, loss, data, settings, derive(task.seed, "order", name), save_to, task.progress)
