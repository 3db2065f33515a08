"""The composed rung: frozen encoder, learned detector, learned binder (inventory N78, N79, B5).

Slots over frozen tokens are the detector, a learned tracker (B3) binds. The detector starts by
distillation from the fixed one and is then released: it goes on by reconstruction alone, a tenth
as fast, and the running mean of its weights is what is kept. No true position is read, and when
clips are read there is no fixed detector: slots propose, the frame's reconstruction decides.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from binders.slots import CHANNELS
from encoders.features import FeatureMap
from encoders.frozen.catalogue import load_encoder
from encoders.jepa import follow
from readouts.scale import FeatureScale
from vidphys.perception.anonymous import LearnedBinding, learn_hindsight
from vidphys.perception.base import FitTask, Grounding, Perception
from vidphys.perception.cnn import train
from vidphys.perception.detections import Remembering, anonymous_world, detections_of
from vidphys.perception.frozen import encode_clips
from vidphys.perception.reconstruction import Reconstruction
from vidphys.perception.slots import LENGTH, SlotDetector, SlotSight, slot_settings
from vidphys.perception.windows import Window, WindowBatches
from vidphys.seeding import derive

RELEASED = 0.5  # steps of the release over those of the distillation
SLOWER = 0.1  # learning rate of the release over that of the distillation
KEEP = 0.98  # of the running mean, a step


class FrozenTokens(nn.Module):
    """Frozen features, standardised and projected to what slots read.

    Args:
        values: of the training clips, ``(b, t, c, h, w)``; they set the scale.
        stride: of the feature map, pixels.
    """

    def __init__(self, values: Tensor, stride: tuple[float, float]) -> None:
        super().__init__()
        self.stride = stride
        self.scale = FeatureScale(values.shape[2])
        self.scale.fit(values.flatten(0, 1))
        self.project = nn.Linear(values.shape[2], CHANNELS)

    def forward(self, values: Tensor) -> FeatureMap:
        """Features of ``CHANNELS`` channels; the time stamps say nothing."""
        tokens = self.project(self.scale(values.movedim(2, -1)))
        return FeatureMap(tokens.movedim(-1, 2), self.stride, torch.zeros(values.shape[1]))


class Released(nn.Module):
    """A detector in training, and the running mean of its weights.

    Args:
        detector: is trained.
    """

    def __init__(self, detector: SlotDetector) -> None:
        super().__init__()
        self.detector = detector
        self.mean = copy.deepcopy(detector).requires_grad_(False)

    def loss(self, view: View, teacher: Reconstruction) -> Tensor:
        """Error of reconstruction; the mean takes the weights that the last step led to."""
        follow(self.mean, self.detector, KEEP)
        return self.detector.loss(view.values, view.window.frames, teacher)


@dataclass(frozen=True)
class View:
    """Windows of frames with what a detector taught about them, and their features."""

    window: Window
    values: Tensor


@dataclass(frozen=True)
class Views:
    """Every window of some clips.

    Args:
        windows: of the frames.
        values: features of the clips, ``(b, t, c, h, w)``.
    """

    windows: WindowBatches
    values: Tensor

    def __len__(self) -> int:
        return len(self.windows)

    def __getitem__(self, index: Tensor) -> View:
        clip, first = index // self.windows.starts, index % self.windows.starts
        frame = first[:, None] + torch.arange(self.windows.length)
        return View(self.windows[index], self.values[clip[:, None], frame])


def fit_composed(encoder_name: str, options: dict[str, Any], task: FitTask) -> Perception:
    """Encode the clips, train the detector on their tokens, then a tracker on what it finds.

    Args:
        encoder_name: of ``encoders.frozen.catalogue``; one that has a feature frame for each frame.
        options: of its settings.
        task: see :class:`FitTask`.

    Raises:
        WeightsMissing: the encoder's weights are not on this machine.
        InputError: the clips are not of the anonymous world, or too short.
    """
    world, bodies = anonymous_world(task.clips), task.clips.params.mass.shape[-1]
    name, teacher = f"composed-{encoder_name}", Reconstruction.through(world)
    encoder = load_encoder(encoder_name, options)
    features = encode_clips(encoder, task.clips, task.folder)
    torch.manual_seed(derive(task.seed, "init", name))
    tokens = FrozenTokens(features.values, features.stride)
    detector = SlotDetector(tokens, bodies, world.camera.half_extent, teacher.fine)
    taught = detections_of(task.clips, task.folder).positions
    views = Views(WindowBatches(task.clips, LENGTH, taught), features.values)

    def distil(view: View) -> Tensor:
        return detector.loss(view.values, view.window.frames, teacher, view.window.targets)

    settings = slot_settings(task)
    train(task, f"{name}-distilled", detector, distil, views, settings)
    slower = replace(
        settings,
        steps=int(RELEASED * settings.steps),
        learning_rate=SLOWER * settings.learning_rate,
    )
    released = Released(detector)
    train(task, f"{name}-released", released, lambda v: released.loss(v, teacher), views, slower)
    mean = released.mean.eval()
    sight = Remembering(
        SlotSight(mean, teacher, lambda seen: encode_clips(encoder, seen, task.folder).values)
    )
    tracker = learn_hindsight(task, f"{name}-tracker", sight(task.clips))
    return LearnedBinding(tracker, detect=sight)


COMPOSED_GROUNDINGS = [
    Grounding(
        name, "anonymous", encoder, "slots", False, partial(fit_composed, encoder, options), share
    )
    for name, encoder, options, share in (
        ("composed", "dino-tiny", {"batch": 8}, 4),
        ("composed-hiera", "hiera", {}, 8),
    )
]
