"""Training a dynamics head on perceived tracks: positions at frames, and nothing else.

Two ways, one for each readout of the ladder:

``differencing`` is the study's: momentum from central differences, then one frame ahead.

``shooting`` trains on spline states first, where these can be trusted, and then on stretches of
several frames whose start states are fitted along with the head. Only positions are compared,
and a stretch that the head cannot yet explain pulls neither its start nor the weights far.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from binders import Tracks
from dynamics import Head, Parameters, PhaseState, Rollout
from dynamics.rollout import first_bad_step
from readouts.differencing import central_difference
from vidphys.perception.base import model_step
from vidphys.segments import (
    Segments,
    from_trajectory,
    roll,
    scale_of,
    segment_loss,
    standardise,
)
from vidphys.smoothing import Smoothed, smooth
from vidphys.train import (
    FitResult,
    FitSettings,
    Progress,
    choose_learning_rate,
    fit,
)

SMOOTH_BATCH, FRAME_BATCH, STRETCH_BATCH = 1024, 256, 160
SMOOTH_RATES = (3e-3, 1e-3)
PROBE = 0.1
STRETCH_RATE, STRETCH_CLIP = 1e-2, 0.1
TRUSTED = 0.8
EXPLAINED = 0.03  # world units: residuals beyond this do not move a start
# World units: residuals beyond this hardly move the weights. It shrinks as training goes on
# (graduated non-convexity): first every encounter is heard, in the end only fine differences.
SURPRISE = (0.2, 0.02)


@dataclass(frozen=True)
class TrackTask:
    """What a head is trained on.

    Args:
        tracks: perceived positions of the training clips.
        params: the law of each clip.
        interval: seconds between frames.
        smooth_steps, shooting_steps: optimiser steps of the two stages.
        seed: of the batch order.
        stretch: frames that a head is rolled ahead of a fitted start.
        save_to: folder of checkpoints, or ``None``.
        progress: called as ``(step, steps, loss)``.
    """

    tracks: Tracks
    params: Parameters
    interval: float
    smooth_steps: int
    shooting_steps: int
    seed: int
    stretch: int = 5
    save_to: Path | None = None
    progress: Progress | None = None

    def checkpoint(self, stage: str) -> Path | None:
        return None if self.save_to is None else self.save_to / f"{stage}.json"


def train_by_differencing(head: Head, task: TrackTask) -> FitResult:
    """One frame ahead from central-difference states, in (q, p)."""
    states = central_difference(task.tracks.positions, task.params.mass, task.interval)
    trajectory = Rollout(states, task.params, task.interval, first_bad_step(states))
    data = from_trajectory(trajectory, k=1, every=model_step(task.interval)[1])
    return _fit_segments(head, data, task, FRAME_BATCH, "differencing")


def train_by_shooting(head: Head, task: TrackTask) -> FitResult:
    """One step ahead on trusted spline states, then stretches with fitted starts."""
    smoothed = smooth(task.tracks.positions, task.params, task.interval)
    data = _trusted(from_trajectory(smoothed.trajectory, k=1), smoothed.trust[:, :-1])
    _fit_segments(head, data, task, SMOOTH_BATCH, "smooth")
    stretches = _Stretches(smoothed, task)
    settings = FitSettings(task.shooting_steps, STRETCH_BATCH, STRETCH_RATE, STRETCH_CLIP)
    together = nn.ModuleList([head, stretches])
    loss = stretch_loss(head, stretches, task.shooting_steps)
    return fit(
        together,
        loss,
        stretches,
        settings,
        task.seed + 1,
        task.checkpoint("shooting"),
        task.progress,
    )


def _trusted(data: Segments, trust: Tensor) -> Segments:
    return data[torch.nonzero(trust.flatten() > TRUSTED / 2).squeeze(-1)]


def _fit_segments(head: Head, data: Segments, task: TrackTask, batch: int, stage: str) -> FitResult:
    """Choose the learning rate on held-out segments, then train."""
    train, held_out = data.split(max(1, len(data) // 16))
    standardise(head, train)
    scale = scale_of(train)
    probe = FitSettings(max(1, int(PROBE * task.smooth_steps)), batch, 0.0)
    choice = choose_learning_rate(
        head,
        lambda candidate: segment_loss(candidate, scale),
        train,
        held_out[slice(0, 4096)],
        SMOOTH_RATES,
        probe,
        task.seed,
    )
    settings = FitSettings(task.smooth_steps, batch, choice.chosen, clip=10.0)
    loss = segment_loss(head, scale)
    return fit(head, loss, train, settings, task.seed, task.checkpoint(stage), task.progress)


class _Stretches(nn.Module):
    """Windows of observed positions and their start states, which training refines.

    The starts are buffers, so that a checkpoint of the training holds them.
    """

    q: Tensor
    p: Tensor
    draws: Tensor

    def __init__(self, smoothed: Smoothed, task: TrackTask) -> None:
        super().__init__()
        positions = task.tracks.positions
        length = min(task.stretch, positions.shape[1] - 3)
        every = smoothed.per_frame
        at = range(1, positions.shape[1] - 1 - length + 1, 2)
        states = smoothed.trajectory.states

        def windows(x: Tensor) -> Tensor:
            return torch.cat([x[:, s : s + length + 1] for s in at]).float()

        fine = [(s - 1) * every for s in at]
        trust = torch.cat([smoothed.trust[:, f] for f in fine])
        keep = torch.nonzero(trust > TRUSTED).squeeze(-1)
        if not len(keep):
            keep = torch.arange(len(trust))
        self.register_buffer("q", torch.cat([states.q[:, f] for f in fine])[keep].float())
        self.register_buffer("p", torch.cat([states.p[:, f] for f in fine])[keep].float())
        self.register_buffer("draws", torch.zeros((), dtype=torch.float64))
        self.observed = windows(positions)[keep]
        self.confidence = windows(task.tracks.confidence)[keep]
        repeated = task.params.map(lambda x: torch.cat([x] * len(fine)).float())
        self.params, self.interval = repeated[keep], task.interval

    def __len__(self) -> int:
        return len(self.observed)

    def __getitem__(self, index: Tensor) -> Tensor:
        """The stretches' own numbers: the loss reads and moves their starts in place."""
        return index

    def refine(self, index: Tensor, residual: Tensor) -> None:
        """Move starts by a robust straight-line fit to the residuals ``(b, t, n, d)``.

        A Gauss-Newton step with the Jacobian of free motion. Residuals beyond ``EXPLAINED``
        weigh little: after an encounter that the head does not know yet, they would mislead.
        """
        time = (self.interval * torch.arange(residual.shape[1]))[None, :, None, None]
        excess = residual.square().sum(-1, keepdim=True) / EXPLAINED**2
        weight = self.confidence[index].unsqueeze(-1) / (1 + excess).square()
        s0, s1, s2 = (weight.sum(1), (weight * time).sum(1), (weight * time**2).sum(1))
        r0, r1 = -(weight * residual).sum(1), -(weight * residual * time).sum(1)
        determinant = s0 * s2 - s1 * s1 + 1e-3 * self.interval**2
        mass = self.params[index].mass[..., None]
        self.q[index] += 0.5 * (s2 * r0 - s1 * r1) / determinant
        self.p[index] += 0.5 * mass * (s0 * r1 - s1 * r0) / determinant


def stretch_loss(head: Head, stretches: _Stretches, steps: int) -> Callable[[Tensor], Tensor]:
    """Robust (Cauchy) position error of the rolled-out stretches, in units of its own scale."""
    dt, every = model_step(stretches.interval)

    def loss(index: Tensor) -> Tensor:
        start = PhaseState(stretches.q[index], stretches.p[index])
        frames = stretches.observed.shape[1] - 1
        rolled = roll(head, start, stretches.params[index], frames, dt, every)
        predicted = torch.cat([start.q.unsqueeze(1), rolled.q], 1)
        residual = predicted - stretches.observed[index]
        with torch.no_grad():
            stretches.refine(index, residual)
            stretches.draws += 1
        first, last = SURPRISE
        scale = first * (last / first) ** min(1.0, float(stretches.draws) / steps)
        error = residual.square().sum(-1) / scale**2
        return (stretches.confidence[index] * torch.log1p(error)).mean()

    return loss
