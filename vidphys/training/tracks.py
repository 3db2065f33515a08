"""Training a dynamics head on perceived tracks: positions at frames, and nothing else.

Two ways, one for each readout of the ladder:

``differencing`` is the study's: momentum from central differences, then one frame ahead.

``shooting`` goes on from there: it starts each short window from the state that the head itself
carries from its first frame to its second, and compares positions in the frames after. No
difference of frames enters, so that encounters shorter than a frame interval are learned too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from binders import Tracks
from dynamics import Head, Parameters, Rollout
from dynamics.rolling import first_bad_step
from readouts.differencing import central_difference
from vidphys.progress import Progress
from vidphys.shooting.aim import PRECISE, surprise
from vidphys.shooting.step import model_step
from vidphys.training.learner import OnNan
from vidphys.training.loop import Batches, FitResult, FitSettings, Loss, choose_learning_rate, fit
from vidphys.training.segments import Segments, from_trajectory, scale_of, segment_loss, standardise


@dataclass(frozen=True)
class Stage:
    """How one kind of examples is trained on: its checkpoint's name, batch, rates and clipping."""

    name: str
    batch: int
    rates: tuple[float, ...]
    clip: float


@dataclass(frozen=True)
class TrackSettings:
    """Of a head's training on tracks.

    Args:
        frames, windows: the stages by differences of frames, and by windows.
        probe: share of the steps that each learning rate is tried for.
        held_out: examples at most that a learning rate is chosen on.
    """

    frames: Stage = Stage("differencing", 256, (3e-3, 1e-3), 10.0)
    windows: Stage = Stage("shooting", 256, (1e-2, 1e-3), 1.0)
    probe: float = 0.1
    held_out: int = 4096


@dataclass(frozen=True)
class TrackTask:
    """What a head is trained on.

    Args:
        tracks: perceived positions of the training clips.
        params: the law of each clip.
        interval: seconds between frames.
        steps: optimiser steps in all.
        seed: of the batch order.
        ahead: frames that are predicted after the two that start a window.
        precise: position errors below it count by their square, above by their logarithm.
        save_to: folder of checkpoints, or ``None``.
        progress: called as ``(step, steps, loss)``.
        settings: see :class:`TrackSettings`.
        on_nan: see :class:`FitSettings`.
    """

    tracks: Tracks
    params: Parameters
    interval: float
    steps: int
    seed: int
    ahead: int = 2
    precise: float = PRECISE
    save_to: Path | None = None
    progress: Progress | None = None
    settings: TrackSettings = TrackSettings()
    on_nan: OnNan = "stop"

    def checkpoint(self, stage: str) -> Path | None:
        return None if self.save_to is None else self.save_to / f"{stage}.json"

    def differences(self) -> Segments:
        """One frame ahead from central-difference states."""
        states = central_difference(self.tracks.positions, self.params.mass, self.interval)
        trajectory = Rollout(states, self.params, self.interval, first_bad_step(states))
        return from_trajectory(trajectory, k=1, every=model_step(self.interval)[1])


def tell_scale(head: Head, task: TrackTask) -> None:
    """Tell an untrained head how far bodies go in a step, where it needs to know."""
    standardise(head, task.differences())


def train_by_differencing(head: Head, task: TrackTask) -> FitResult:
    """One frame ahead from central-difference states, in (q, p)."""
    data = task.differences()
    scale = scale_of(data)
    stage = task.settings.frames
    return _fit(head, lambda candidate: segment_loss(candidate, scale), data, stage, task)


def train_by_shooting(head: Head, task: TrackTask) -> FitResult:
    """As by differencing for half of the steps, then windows that start by aiming.

    The differences tell a head without structure what a momentum is; the windows then let go of
    their truncation error.
    """
    half, stage = replace(task, steps=task.steps // 2), task.settings.windows
    train_by_differencing(head, half)
    return _fit(head, lambda candidate: window_loss(candidate, task), Windows(half), stage, half)


def _fit(
    head: Head, loss: Callable[[Head], Loss], data: Batches, stage: Stage, task: TrackTask
) -> FitResult:
    """Choose the learning rate on held-out examples, then train."""
    held_out = max(1, min(task.settings.held_out, len(data) // 16))
    train = First(data, len(data) - held_out)
    tried = max(1, int(task.settings.probe * task.steps))
    probe = FitSettings(tried, stage.batch, 0.0, stage.clip)
    last = data[torch.arange(len(train), len(data))]
    choice = choose_learning_rate(head, loss, train, last, stage.rates, probe, task.seed)
    settings = FitSettings(task.steps, stage.batch, choice.chosen, stage.clip, on_nan=task.on_nan)
    save_to = task.checkpoint(stage.name)
    return fit(head, loss(head), train, settings, task.seed, save_to, task.progress)


@dataclass(frozen=True)
class First:
    """The first ``count`` examples of some data."""

    data: Batches
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: Tensor) -> Any:
        return self.data[index]


@dataclass(frozen=True)
class TrackBatch:
    """Positions ``(m, frames, n, d)``, confidence ``(m, frames, n)`` and the law of each."""

    positions: Tensor
    confidence: Tensor
    params: Parameters


class Windows:
    """Every window of ``ahead + 2`` neighbouring frames in some tracks, in float32."""

    def __init__(self, task: TrackTask) -> None:
        self.positions = task.tracks.positions.float()
        self.confidence = task.tracks.confidence.float()
        self.params = task.params.map(torch.Tensor.float)
        frames = self.positions.shape[1]
        self.length = task.ahead + 2
        self.starts = frames - self.length + 1
        if self.starts < 1:
            raise ValueError(
                f"train_by_shooting: windows of {self.length} frames, but the tracks have {frames}"
            )

    def __len__(self) -> int:
        return len(self.positions) * self.starts

    def __getitem__(self, index: Tensor) -> TrackBatch:
        clip = index // self.starts
        frame = (index % self.starts)[:, None] + torch.arange(self.length)
        cut = clip[:, None], frame
        return TrackBatch(self.positions[cut], self.confidence[cut], self.params[clip])


def window_loss(head: Head, task: TrackTask) -> Callable[[TrackBatch], Tensor]:
    """How far the head is from the tracks after the two frames that it was started on.

    A window counts as much as the least sure of the positions that start it.
    """
    dt, every = model_step(task.interval)

    def loss(batch: TrackBatch) -> Tensor:
        error = surprise(head, batch.positions, batch.params, dt, every, task.precise)
        sure = batch.confidence[:, :2].amin((1, 2), keepdim=True)
        return (sure * batch.confidence[:, 2:] * error).mean()

    return loss
