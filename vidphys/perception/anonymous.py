"""The anonymous rungs: bodies that all look alike, one fixed detector, three ways to bind.

The detector finds the bodies of each frame, in no order; a binder decides who is who over time.
By hand (B1); by a tracker that learned from what is smoothest in hindsight (B3); and by a tracker
trained together with the dynamics head, which then foresees each next frame for it (B2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from binders import Detections, Tracks, bind_by_acceleration
from binders.tracker import (
    HYPOTHESES,
    SoftTracks,
    Tracker,
    extrapolate,
    follow,
    follow_softly,
    sinkhorn,
)
from dynamics import Head, Parameters
from vidphys.data.clips import Clips
from vidphys.perception.base import FitTask, Grounding, Perception
from vidphys.perception.detections import (
    WINDOW,
    Windows,
    anonymous_world,
    detections_of,
    windows_of,
)
from vidphys.perception.discovered import new_head
from vidphys.perception.windows import steps_per_frame
from vidphys.seeding import derive
from vidphys.shooting.aim import PRECISE, motion_under, surprise
from vidphys.shooting.step import HEAD_DT
from vidphys.training.loop import FitSettings, fit

AHEAD = 2  # frames that the head predicts after the two that it starts from
LEARNING_RATE = 1e-2
MANY = 36  # hypotheses of the teacher


@dataclass(frozen=True)
class HandBinding:
    """The detector and the hand-made binder; nothing is learned."""

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame, numbered as found in the first."""
        return bind_by_acceleration(detections_of(clips))


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
    detect: Callable[[Clips], Detections] = detections_of

    def under(self, head: Head) -> LearnedBinding:
        """The same with another head: one that was trained on the tracks, say."""
        return replace(self, head=head)

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame, numbered as found in the first."""
        found = self.detect(clips)
        plain, score = follow(self.tracker, found, hypotheses=self.hypotheses)
        if self.head is None:
            return plain
        law = clips.params.map(lambda x: x.float())
        motion = motion_under(self.head, law, steps_per_frame(clips))
        foreseen, better = follow(self.tracker, found, motion, self.hypotheses)
        chosen = (better > score)[:, None, None]
        return Tracks(
            torch.where(chosen.unsqueeze(-1), foreseen.positions, plain.positions),
            torch.where(chosen, foreseen.confidence, plain.confidence),
            plain.times,
        )


def fit_hand(task: FitTask) -> Perception:
    """Nothing to fit."""
    anonymous_world(task.clips)
    return HandBinding()


def fit_twostage(task: FitTask) -> Perception:
    """Train the tracker to decide at once as the smoothest tracks do in hindsight, then freeze it.

    The untrained tracker follows many histories of each clip to its end, and the smoothest is
    the teacher. No label and no head is involved.
    """
    found = detections_of(task.clips, task.folder)
    return LearnedBinding(learn_hindsight(task, "anonymous-tracker-twostage", found), hypotheses=1)


def learn_hindsight(task: FitTask, name: str, found: Detections) -> Tracker:
    """A tracker that learned from the smoothest tracks through some detections.

    Args:
        task: see :class:`FitTask`.
        name: of its random streams and checkpoint.
        found: detections in the task's clips.
    """
    tracker = _new_tracker(task, name)
    smooth, _ = follow(tracker, found, hypotheses=MANY)
    teacher = Detections(smooth.positions, smooth.confidence, smooth.times)
    data = windows_of(teacher, task.clips.params)

    def loss(batch: Windows) -> Tensor:
        return hindsight_loss(tracker, batch.detections)

    _train(task, name, tracker, loss, data)
    return tracker.eval()


def fit_end_to_end(task: FitTask) -> Perception:
    """Train tracker and head by one decode-free loss: tracks that the head predicts.

    Raises:
        InputError: as for the others, or the frame interval is not a multiple of ``HEAD_DT``.
    """
    name = f"anonymous-tracker-{task.head}"
    tracker, head = _new_tracker(task, name), new_head(task, name)
    every = steps_per_frame(task.clips)

    def loss(batch: Windows) -> Tensor:
        tracks = follow_softly(tracker, batch.detections)
        return prediction_loss(head, tracks, batch.params, every)

    data = windows_of(detections_of(task.clips, task.folder), task.clips.params)
    _train(task, name, nn.ModuleList([tracker, head]), loss, data)
    return LearnedBinding(tracker.eval(), head.eval())


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
    part = sinkhorn(torch.stack(scores, 1))
    return -part.diagonal(dim1=-2, dim2=-1).clamp_min(1e-6).log().mean()


def prediction_loss(head: Head, tracks: SoftTracks, params: Parameters, every: int) -> Tensor:
    """Distance of the head's predictions from the tracks' own future, and the doubt in them.

    Args:
        head: predicts.
        tracks: at least ``AHEAD + 2`` frames.
        params: of each window, ``(m,)`` and ``(m, n)``.
        every: model steps between frames.
    """
    windows = tracks.positions.unfold(1, AHEAD + 2, 1).movedim(-1, 2)
    starts = windows.shape[1]
    law = params.map(lambda x: x.unsqueeze(1).expand(-1, starts, *x.shape[1:]))
    missed = surprise(head, windows, law, HEAD_DT, every)
    return missed.mean() + (tracks.variance / PRECISE**2).log1p().mean()


def _new_tracker(task: FitTask, name: str) -> Tracker:
    torch.manual_seed(derive(task.seed, "init", name))
    return Tracker()


def _train(
    task: FitTask,
    name: str,
    modules: nn.Module,
    loss: Callable[[Windows], Tensor],
    data: Windows,
) -> None:
    batch = max(1, task.sizes.perception_batch // WINDOW)
    settings = FitSettings(task.sizes.perception_steps, batch, LEARNING_RATE, clip=1.0)
    save_to = None if task.folder is None else task.folder / f"{name}.json"
    fit(modules, loss, data, settings, derive(task.seed, "order", name), save_to, task.progress)


ANONYMOUS_GROUNDINGS = [
    Grounding("anonymous-hand", "anonymous", "none", "hand", False, fit_hand),
    Grounding("anonymous-tracker", "anonymous", "none", "tracker", True, fit_end_to_end),
    Grounding("anonymous-tracker-twostage", "anonymous", "none", "tracker", False, fit_twostage),
]
