"""Training a model of exactly the terms that a diagnosis found, on the tracks that it was given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from binders import Tracks
from dynamics import Head, Parameters, build, rollout
from dynamics.terms import HamiltonianTerms
from vidphys.diagnose.motion import Motion
from vidphys.diagnose.specification import BATH
from vidphys.errors import InputError
from vidphys.initial_state import by_shooting
from vidphys.perception.base import model_step
from vidphys.training.loop import Progress
from vidphys.training.tracks import TrackTask, tell_scale, train_by_shooting

EVEN = 0.1  # share by which frame intervals may differ
AHEAD = 4  # frames that are predicted after the two that start a window
PRECISE = 0.1  # coordinate units: errors below count by their square


@dataclass(frozen=True)
class Trained:
    """A model with its forecast of the frames that it was not trained on.

    Args:
        head: of the specified terms.
        error: root mean squared distance on those frames, in the unit of the tracks; ``None``
            where there are none.
        still: the same for a body that stays where it last was.
    """

    head: Head
    error: float | None
    still: float | None


def train_specified(
    terms: HamiltonianTerms,
    held: Mapping[str, Any],
    motion: Motion,
    end: int,
    steps: int,
    seed: int,
    progress: Progress | None = None,
) -> Trained:
    """Train a model of these terms on the frames before ``end``, and roll it over the rest.

    Args:
        terms, held: see :func:`vidphys.diagnose.specification.read_specification`.
        motion: evenly spaced tracks.
        end: frame to stop before.
        steps: optimiser steps.
        seed: of initial weights and batch order.
        progress: called as ``(step, steps, loss)``.

    Raises:
        InputError: tracks of another scene, frames that are not even, or a heat bath.
    """
    _check(terms, held, motion)
    origin = np.asarray(held["origin"])
    mass = torch.tensor(held.get("mass", [1.0] * motion.bodies)).expand(motion.clips, -1)
    coupling = np.ones(motion.clips) if motion.coupling is None else motion.coupling
    params = Parameters(torch.tensor(coupling).float(), mass.float())
    positions = torch.from_numpy(np.nan_to_num(motion.positions - origin)).float()
    sure = torch.from_numpy(motion.seen).float()
    times = torch.from_numpy(motion.times[0])
    tracks = Tracks(positions[:, :end], sure[:, :end], times[:end])
    torch.manual_seed(seed)
    head = build(terms, motion.bodies, model_step(motion.interval)[0], motion.space)
    task = TrackTask(
        tracks, params, motion.interval, steps, seed, AHEAD, PRECISE, progress=progress
    )
    tell_scale(head, task)
    train_by_shooting(head, task)
    if end >= motion.positions.shape[1]:
        return Trained(head, None, None)
    return _foretold(head, positions, sure, params, motion.interval, end)


def _check(terms: HamiltonianTerms, held: Mapping[str, Any], motion: Motion) -> None:
    if (motion.bodies, motion.space) != (held["bodies"], held["space"]):
        raise InputError(
            f"train: the specification is of {held['bodies']} bodies in {held['space']} "
            f"dimensions, the tracks are of {motion.bodies} in {motion.space}"
        )
    gaps = np.diff(motion.times, axis=1)
    if np.abs(gaps - motion.interval).max() > EVEN * motion.interval:
        raise InputError("train: frames are not evenly spaced; resample the tracks")
    if BATH in terms.ports:
        raise InputError("train: a heat bath is not learned from tracks, only its rate is known")


def _foretold(
    head: Head,
    positions: torch.Tensor,
    sure: torch.Tensor,
    params: Parameters,
    interval: float,
    end: int,
) -> Trained:
    times = interval * torch.arange(end)
    start = by_shooting(head, Tracks(positions[:, :end], sure[:, :end], times), params, interval)
    dt, every = model_step(interval)
    ahead = positions.shape[1] - end
    rolled = rollout(head, start, params, ahead * every, dt, every).states.q[:, 1:]
    seen, weight = positions[:, end:], sure[:, end:]

    def error(path: torch.Tensor) -> float:
        squared = ((path - seen) ** 2).sum(-1)
        return float(((squared * weight).sum() / weight.sum()).sqrt())

    return Trained(head, error(rolled), error(positions[:, end - 1 : end].expand_as(seen)))
