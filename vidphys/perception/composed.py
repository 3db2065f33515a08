"""The composed rung: frozen encoder, learned detector, learned binder.

Slots over frozen tokens are the detector, a learned tracker binds. The detector starts by
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

from binders.detect import DetectorSettings
from binders.slots import SlotSettings
from encoders.features import FeatureMap
from encoders.frozen.catalogue import load_encoder
from encoders.jepa import follow
from readouts.scale import FeatureScale
from vidphys.perception.anonymous import LearnedBinding, TrackingSettings, learn_hindsight
from vidphys.perception.base import BLOBS, DETECTOR, DISK, FitTask, Grounding, Perception
from vidphys.perception.cnn import train
from vidphys.perception.detections import (
    FixedDetector,
    Remembering,
    detections_of,
    known_world,
)
from vidphys.perception.frozen import encode_clips
from vidphys.perception.reconstruction import Reconstruction
from vidphys.perception.slots import ALONE, DetectionSettings, SlotDetector, SlotSight
from vidphys.perception.windows import Window, WindowBatches
from vidphys.seeding import derive


@dataclass(frozen=True)
class ComposedSettings:
    """Of the composed rung.

    Args:
        detector: the fixed one that teaches; see :class:`DetectorSettings`.
        released: steps of the release over those of the distillation.
        slower: learning rate of the release over that of the distillation.
        keep: of the running mean, a step.
    """

    detector: DetectorSettings = DetectorSettings()
    detection: DetectionSettings = DetectionSettings()
    tracking: TrackingSettings = TrackingSettings()
    released: float = 0.5
    slower: float = 0.1
    keep: float = 0.98


class FrozenTokens(nn.Module):
    """Frozen features, standardised and projected to what slots read.

    Args:
        values: of the training clips, ``(b, t, c, h, w)``; they set the scale.
        stride: of the feature map, pixels.
        channels: of the tokens.
    """

    def __init__(
        self, values: Tensor, stride: tuple[float, ...], channels: int = SlotSettings.channels
    ) -> None:
        super().__init__()
        self.stride = stride
        self.scale = FeatureScale(values.shape[2])
        self.scale.fit(values.flatten(0, 1))
        self.project = nn.Linear(values.shape[2], channels)

    def forward(self, values: Tensor) -> FeatureMap:
        """The tokens; their time stamps say nothing."""
        tokens = self.project(self.scale(values.movedim(2, -1)))
        return FeatureMap(tokens.movedim(-1, 2), self.stride, torch.zeros(values.shape[1]))


class Released(nn.Module):
    """A detector in training, and the running mean of its weights.

    Args:
        detector: is trained.
        keep: of the running mean, a step.
    """

    def __init__(self, detector: SlotDetector, keep: float = ComposedSettings.keep) -> None:
        super().__init__()
        self.detector, self.keep = detector, keep
        self.mean = copy.deepcopy(detector).requires_grad_(False)

    def loss(self, view: View, teacher: Reconstruction) -> Tensor:
        """Error of reconstruction; the mean takes the weights that the last step led to."""
        follow(self.mean, self.detector, self.keep)
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


def fit_composed(
    encoder_name: str,
    options: dict[str, Any],
    task: FitTask,
    settings: ComposedSettings = ComposedSettings(),
    blobs: bool = False,
) -> Perception:
    """Encode the clips, train the detector on their tokens, then a tracker on what it finds.

    Args:
        encoder_name: of ``encoders.frozen.catalogue``; one that has a feature frame for each frame.
        options: of its settings.
        task: see :class:`FitTask`.
        blobs: whether no more is known of bodies than that they are blobs.

    Raises:
        WeightsMissing: the encoder's weights are not on this machine.
        InputError: the clips are not of the anonymous world, or too short.
    """
    world, bodies = known_world(task.clips, blobs), task.clips.params.mass.shape[-1]
    detection, tracking = settings.detection, settings.tracking
    name, teacher = (
        f"composed-{encoder_name}",
        Reconstruction.through(world, detection.teacher, task.device),
    )
    encoder = load_encoder(encoder_name, options, device=task.device)
    features = encode_clips(encoder, task.clips, task.folder)
    torch.manual_seed(derive(task.seed, "init", name))
    tokens = FrozenTokens(features.values, features.stride, detection.attention.channels)
    size = world.camera.half_extent, teacher.fine
    detector = SlotDetector(tokens, bodies, *size, detection).to(task.device)
    fixed = FixedDetector(settings.detector, world, task.device)
    taught = detections_of(task.clips, task.folder, fixed).positions
    views = Views(WindowBatches(task.clips, detection.length, taught), features.values)

    def distil(view: View) -> Tensor:
        return detector.loss(view.values, view.window.frames, teacher, view.window.targets)

    how = detection.fit(task.sizes)
    train(task, f"{name}-distilled", detector, distil, views, how)
    steps, rate = int(settings.released * how.steps), settings.slower * how.learning_rate
    slower = replace(how, steps=steps, learning_rate=rate)
    released = Released(detector, settings.keep)
    train(task, f"{name}-released", released, lambda v: released.loss(v, teacher), views, slower)
    mean = released.mean.eval()
    sight = Remembering(
        SlotSight(mean, teacher, lambda seen: encode_clips(encoder, seen, task.folder).values)
    )
    tracker = learn_hindsight(task, f"{name}-tracker", sight(task.clips), tracking)
    return LearnedBinding(tracker, None, tracking.hypotheses, sight)


def _rungs(name: str, encoder: str, options: dict[str, Any], share: int) -> list[Grounding]:
    fit = partial(fit_composed, encoder, options)
    seen = name, "anonymous", encoder, "slots", False
    own = Grounding(*seen, fit, DETECTOR, DISK, share)
    alone = ComposedSettings(detection=ALONE)
    return [
        own,
        own.varied("proposals", settings=alone),
        own.varied("blobs", knows=BLOBS, blobs=True),
    ]


COMPOSED_GROUNDINGS = [
    *_rungs("composed", "dino-tiny", {"batch": 8}, 4),
    *_rungs("composed-hiera", "hiera", {}, 8),
]
