"""The anonymous rungs: bodies that all look alike, one fixed detector, three ways to bind.

The detector finds the bodies of each frame, in no order; a binder decides who is who over time.
By hand; by a tracker that learned from what is smoothest in hindsight; and by a tracker trained
together with the dynamics head, which then foresees each next frame for it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor, nn

from binders import Detections, Tracks, bind_by_acceleration
from binders.detect import DetectorSettings
from binders.tracker import (
    HYPOTHESES,
    SoftTracks,
    Tracker,
    TrackerSettings,
    extrapolate,
    follow,
    follow_softly,
    sinkhorn,
)
from dynamics import Head, Parameters
from vidphys.data.clips import Clips
from vidphys.perception.base import BLOBS, DISK, UNTOLD, FitTask, Grounding, Perception
from vidphys.perception.cnn import train
from vidphys.perception.detections import (
    Detector,
    FixedDetector,
    Remembering,
    Windows,
    detections_of,
    known_world,
    windows_of,
)
from vidphys.perception.discovered import new_head
from vidphys.perception.windows import steps_per_frame
from vidphys.placement import CPU, device_of, moved
from vidphys.presets import PixelSizes
from vidphys.seeding import derive
from vidphys.shooting.aim import PRECISE, motion_under, surprise
from vidphys.shooting.step import HEAD_DT
from vidphys.training.loop import FitSettings


@dataclass(frozen=True)
class TrackingSettings:
    """Of a tracker that is trained on detections.

    Args:
        window: frames that it is trained on at once.
        learning_rate: peak.
        clip: largest gradient norm.
        hypotheses: followed side by side when clips are read.
        teacher: hypotheses of the tracks that are taken for the smoothest.
        ahead: frames that a head predicts after the two that it starts from.
        precise: world units; errors below it count by their square, above by their logarithm.
    """

    network: TrackerSettings = TrackerSettings()
    window: int = 7
    learning_rate: float = 1e-2
    clip: float = 1.0
    hypotheses: int = HYPOTHESES
    teacher: int = 36
    ahead: int = 2
    precise: float = PRECISE

    def fit(self, sizes: PixelSizes) -> FitSettings:
        """As many windows a step as make the preset's frames."""
        windows = max(1, sizes.perception_batch // self.window)
        return FitSettings(sizes.perception_steps, windows, self.learning_rate, self.clip)


@dataclass(frozen=True)
class AnonymousSettings:
    """Of a fixed detector and a learned tracker; see there."""

    detector: DetectorSettings = DetectorSettings()
    tracking: TrackingSettings = TrackingSettings()


@dataclass(frozen=True)
class HandBinding:
    """A detector and the hand-made binder; nothing is learned."""

    detect: Detector

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame, numbered as found in the first."""
        return bind_by_acceleration(self.detect(clips))


@dataclass(frozen=True)
class LearnedBinding:
    """The detector and a trained tracker, with a head that foresees the motion if there is one.

    Args:
        tracker: gives the scores.
        head: foresees each next frame. Each clip is also followed by extrapolation, and keeps
            the tracks of greater score: a head that foresees badly does no harm.
        hypotheses: histories followed side by side.
        detect: finds the bodies of each frame.
    """

    tracker: Tracker
    head: Head | None = None
    hypotheses: int = HYPOTHESES
    detect: Detector = field(default_factory=lambda: Remembering(FixedDetector()))

    def under(self, head: Head) -> LearnedBinding:
        """The same with another head: one that was trained on the tracks, say."""
        return replace(self, head=head)

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame, numbered as found in the first."""
        found, law = moved((self.detect(clips), clips.params), device_of(self.tracker))
        plain, score = follow(self.tracker, found, hypotheses=self.hypotheses)
        if self.head is None:
            return moved(plain, CPU)
        law = law.map(lambda x: x.float())
        motion = motion_under(self.head, law, steps_per_frame(clips))
        foreseen, better = follow(self.tracker, found, motion, self.hypotheses)
        chosen = (better > score)[:, None, None]
        tracks = Tracks(
            torch.where(chosen.unsqueeze(-1), foreseen.positions, plain.positions),
            torch.where(chosen, foreseen.confidence, plain.confidence),
            plain.times,
        )
        return moved(tracks, CPU)


def fit_hand(
    task: FitTask, settings: DetectorSettings = AnonymousSettings.detector, blobs: bool = False
) -> Perception:
    """Nothing to fit, but what blobs look like where no more is known of bodies."""
    world = known_world(task.clips, blobs)
    return HandBinding(Remembering(FixedDetector(settings, world, task.device)))


DECIDING = AnonymousSettings(tracking=TrackingSettings(hypotheses=1))  # each frame at once


def fit_twostage(
    task: FitTask, settings: AnonymousSettings = DECIDING, blobs: bool = False
) -> Perception:
    """Train the tracker to decide at once as the smoothest tracks do in hindsight, then freeze it.

    The untrained tracker follows many histories of each clip to its end, and the smoothest is
    the teacher. No label and no head is involved.
    """
    fixed = FixedDetector(settings.detector, known_world(task.clips, blobs), task.device)
    detect, tracking = Remembering(fixed), settings.tracking
    found = detections_of(task.clips, task.folder, detect)
    tracker = learn_hindsight(task, "anonymous-tracker-twostage", found, tracking)
    return LearnedBinding(tracker, None, tracking.hypotheses, detect)


def learn_hindsight(
    task: FitTask, name: str, found: Detections, settings: TrackingSettings
) -> Tracker:
    """A tracker that learned from the smoothest tracks through some detections.

    Args:
        task: see :class:`FitTask`.
        name: of its random streams and checkpoint.
        found: detections in the task's clips.
    """
    tracker = _new_tracker(task, name, settings)
    given = moved(found, device_of(tracker))
    smooth, _ = moved(follow(tracker, given, hypotheses=settings.teacher), CPU)
    teacher = Detections(smooth.positions, smooth.confidence, smooth.times)
    data = windows_of(teacher, task.clips.params, settings.window)

    def loss(batch: Windows) -> Tensor:
        return hindsight_loss(tracker, batch.detections)

    train(task, name, tracker, loss, data, settings.fit(task.sizes))
    return tracker.eval()


def fit_end_to_end(
    task: FitTask, settings: AnonymousSettings = AnonymousSettings(), blobs: bool = False
) -> Perception:
    """Train tracker and head by one decode-free loss: tracks that the head predicts.

    Raises:
        InputError: as for the others, or the frame interval is not a multiple of ``HEAD_DT``.
    """
    name, tracking = f"anonymous-tracker-{task.head}", settings.tracking
    tracker, head = _new_tracker(task, name, tracking), new_head(task, name)
    every = steps_per_frame(task.clips)

    def loss(batch: Windows) -> Tensor:
        tracks = follow_softly(tracker, batch.detections)
        return prediction_loss(head, tracks, batch.params, every, tracking)

    world = known_world(task.clips, blobs)
    detect = Remembering(FixedDetector(settings.detector, world, task.device))
    found = detections_of(task.clips, task.folder, detect)
    data = windows_of(found, task.clips.params, tracking.window)
    train(task, name, nn.ModuleList([tracker, head]), loss, data, tracking.fit(task.sizes))
    return LearnedBinding(tracker.eval(), head.eval(), tracking.hypotheses, detect)


def hindsight_loss(tracker: Tracker, teacher: Detections) -> Tensor:
    """How little of each detection goes to its own track, ``-log`` of the part.

    Args:
        tracker: is asked in each frame, given the teacher's past.
        teacher: detections sorted by body.
    """
    scores = []
    for frame in range(1, len(teacher.times)):
        past = teacher.positions[:, max(0, frame - 3) : frame]
        slots, confidence = teacher.positions[:, frame], teacher.confidence[:, frame]
        scores.append(tracker(past, extrapolate(past), slots, confidence))
    part = sinkhorn(torch.stack(scores, 1), tracker.settings.rounds)
    return -part.diagonal(dim1=-2, dim2=-1).clamp_min(1e-6).log().mean()


def prediction_loss(
    head: Head,
    tracks: SoftTracks,
    params: Parameters,
    every: int,
    settings: TrackingSettings = TrackingSettings(),
) -> Tensor:
    """Distance of the head's predictions from the tracks' own future, and the doubt in them.

    Args:
        head: predicts.
        tracks: at least ``ahead + 2`` frames.
        params: of each window, ``(m,)`` and ``(m, n)``.
        every: model steps between frames.
    """
    windows = tracks.positions.unfold(1, settings.ahead + 2, 1).movedim(-1, 2)
    starts = windows.shape[1]
    law = params.map(lambda x: x.unsqueeze(1).expand(-1, starts, *x.shape[1:]))
    missed = surprise(head, windows, law, HEAD_DT, every, settings.precise)
    return missed.mean() + (tracks.variance / settings.precise**2).log1p().mean()


def _new_tracker(task: FitTask, name: str, settings: TrackingSettings) -> Tracker:
    torch.manual_seed(derive(task.seed, "init", name))
    return Tracker(settings.network).to(task.device)


ANONYMOUS_GROUNDINGS = [
    rung
    for name, binder, joint, fit in (
        ("anonymous-hand", "hand", False, fit_hand),
        ("anonymous-tracker", "tracker", True, fit_end_to_end),
        ("anonymous-tracker-twostage", "tracker", False, fit_twostage),
    )
    for own in [Grounding(name, "anonymous", "none", binder, joint, fit, UNTOLD, DISK)]
    for rung in (own, own.varied("blobs", knows=BLOBS, blobs=True))
]
