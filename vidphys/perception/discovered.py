"""The discovered rung: positions and law together, from nothing but predicting the next frames.

A window's first frames are encoded, their momentum differenced, the state rolled by the head and
drawn by the fixed renderer; the error is that of the drawing against the frames that came (the
study's Appendix D). No position is ever told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor, nn

from dynamics import HEADS, Head, PhaseState, build
from readouts.differencing import central_difference
from renderers import Camera, ChannelWorld
from vidphys.errors import InputError
from vidphys.perception.base import FitTask, Perception
from vidphys.perception.cnn import CnnPerception, CnnSettings, new_perception, train
from vidphys.perception.windows import Window, WindowBatches, steps_per_frame
from vidphys.presets import PixelSizes
from vidphys.seeding import derive
from vidphys.shooting.step import HEAD_DT, roll
from vidphys.training.loop import FitSettings

SEEN = 3  # frames that are encoded; the start state is at the middle one
TYPICAL = 1.0  # world units per second, and momentum units per second


@dataclass(frozen=True)
class JointSettings:
    """Of an encoder and a head that are trained together.

    Args:
        features: channels of the encoder's map.
        future: frames that are predicted.
        learning_rate: peak.
        clip: largest gradient norm.
    """

    features: int = CnnSettings.features
    future: int = 2
    learning_rate: float = 5e-3
    clip: float = 0.03

    def fit(self, sizes: PixelSizes) -> FitSettings:
        """As many windows a step as make the preset's frames."""
        windows = max(1, sizes.perception_batch // SEEN)
        return FitSettings(sizes.perception_steps, windows, self.learning_rate, self.clip)


@dataclass(frozen=True)
class DiscoverySettings:
    """Of the discovered rung.

    Args:
        first_blur: world units, standard deviation.
        sharp_from: share of the training after which nothing is blurred.
    """

    joint: JointSettings = JointSettings()
    first_blur: float = 1.5
    sharp_from: float = 0.4

    def blur(self, progress: float) -> float:
        """Standard deviation in world units after a share ``progress`` of the training."""
        return self.first_blur * max(0.0, 1 - progress / self.sharp_from)


class Discovery(nn.Module):
    """Encoder and head, trained by one loss.

    Args:
        perception: gives positions of frames.
        head: rolls them.
        world: draws them.
        every: model steps between frames.
        steps: of the training, for the blur's schedule.
    """

    step: Tensor

    def __init__(
        self,
        perception: CnnPerception,
        head: Head,
        world: ChannelWorld,
        every: int,
        steps: int,
        settings: DiscoverySettings = DiscoverySettings(),
    ) -> None:
        super().__init__()
        self.perception, self.head = perception, head
        self.world, self.every, self.steps, self.settings = world, every, steps, settings
        self.register_buffer("step", torch.zeros((), dtype=torch.long))

    def loss(self, window: Window) -> Tensor:
        """What is minimised."""
        return self.error(start_state(self.perception, window, self.every), window)

    def error(self, start: PhaseState, window: Window) -> Tensor:
        """Squared error of the frames predicted from a start, over the energy of the true ones.

        Both are blurred alike, ever less as training goes on: a body is drawn towards its place
        only by light that overlaps with it.
        """
        truth = window.frames[:, SEEN:]
        frames = 1 + truth.shape[1]
        future = roll(self.head, start, window.params, frames, HEAD_DT, self.every)[:, 1:]
        blur = blur_matrices(self.world.camera, self.settings.blur(int(self.step) / self.steps))
        self.step += 1
        error = blurred(self.world(future.q) - truth, *blur)
        return error.square().mean() / blurred(truth, *blur).square().mean()


D = TypeVar("D", bound=Discovery)


def fit_discovered(task: FitTask, settings: DiscoverySettings = DiscoverySettings()) -> Perception:
    """Train encoder and head by predicting future frames; see :func:`discover`."""
    found = discover(task, f"cnn-discovered-{task.head}", Discovery, settings)
    found.perception.head = found.head
    return found.perception.eval()


def discover(task: FitTask, name: str, make: Callable[..., D], settings: DiscoverySettings) -> D:
    """A trained :class:`Discovery` or another of its kind.

    Args:
        task: what is trained on.
        name: of the random streams and the checkpoint.
        make: the untrained one, from the arguments of :class:`Discovery`.

    Raises:
        InputError: the clips are not of the channel world, are too short, or their frame interval
            is not a multiple of ``HEAD_DT``.
    """
    world = task.clips.world
    if not isinstance(world, ChannelWorld):
        raise InputError(
            f"cnn-discovered: draws its predictions one channel per body, got clips of "
            f"{type(world).__name__}; render them in the channel world"
        )
    joint = settings.joint
    perception = new_perception(task, name, CnnPerception, joint.features)
    head = new_head(task, name)
    every, steps = steps_per_frame(task.clips), task.sizes.perception_steps
    discovery = make(perception, head, world, every, steps, settings=settings).to(task.device)
    data = WindowBatches(task.clips, SEEN + joint.future)
    train(task, name, discovery, discovery.loss, data, joint.fit(task.sizes))
    return discovery


def new_head(task: FitTask, name: str) -> Head:
    """An untrained head of the task's name; a residual map is told how far bodies typically go."""
    torch.manual_seed(derive(task.seed, "init", name, "head"))
    head = build(HEADS[task.head], task.clips.params.mass.shape[-1], HEAD_DT)
    head.set_scale(TYPICAL * HEAD_DT, TYPICAL * HEAD_DT)
    return head.to(task.device)


def start_state(perception: CnnPerception, window: Window, every: int) -> PhaseState:
    """The state at the middle of the window's first three frames, ``(m, n, 2)``."""
    positions = perception.locate(window.frames[:, :SEEN])
    return central_difference(positions, window.params.mass, every * HEAD_DT)[:, 0]


def blur_matrices(camera: Camera, width: float) -> tuple[Tensor, Tensor]:
    """Gaussian blur of the rows' axis, ``(H, H)``, and of the columns' axis, ``(W, W)``.

    The identity where the width is much below a pixel.
    """
    return _kernel(camera.ys(), width), _kernel(camera.xs(), width)


def _kernel(at: Tensor, width: float) -> Tensor:
    distance = (at[:, None] - at).square()
    if len(at) < 2 or 5 * width < float(distance[0, 1].sqrt()):
        return torch.eye(len(at))
    weight = (-0.5 * distance / width**2).exp()
    return weight / weight.sum(1).amax()


def blurred(images: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Images ``(..., H, W)`` under the matrices of :func:`blur_matrices`."""
    return rows.to(images) @ images @ columns.to(images).T
