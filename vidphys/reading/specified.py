"""Training a model of exactly the terms that a diagnosis found, on the tracks that it was given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from binders import Tracks
from dynamics import Head, Parameters, build, rollout
from dynamics.fields import UniformField
from dynamics.friction import Friction
from dynamics.terms import Bath, HeadTerm
from vidphys.diagnose.recordings.evened import evened
from vidphys.diagnose.recordings.motion import Motion
from vidphys.errors import InputError
from vidphys.progress import Progress
from vidphys.shooting.initial_state import by_shooting
from vidphys.shooting.step import model_step
from vidphys.training.tracks import TrackTask, tell_scale, train_by_shooting

EVEN = 0.1  # share by which frame intervals may differ
AHEAD = 4  # frames that are predicted after the two that start a window
PRECISE = 0.5  # of the positions' spread: errors below count by their square


@dataclass(frozen=True)
class Units:
    """What a model counts in, so that its numbers are near one whatever the tracks are in.

    Args:
        length: the spread of the positions, in the unit of the tracks.
        seconds: in which a body goes as far at its usual speed.
    """

    length: float
    seconds: float

    @classmethod
    def of(cls, motion: Motion) -> Units:
        """Of tracks that move."""
        length = float(np.nanstd(motion.positions, axis=(0, 1, 2)).max())
        speed = float(np.sqrt(np.nanmean(np.diff(motion.positions, axis=1) ** 2))) / motion.interval
        return cls(length, length / speed) if speed > 0 else cls(1.0, 1.0)

    def motion(self, motion: Motion) -> Motion:
        """The same tracks, counted so."""
        positions, times = motion.positions / self.length, motion.times / self.seconds
        return replace(motion, positions=positions, times=times)

    def start(self, head: Head, numbers: Mapping[str, Any]) -> None:
        """Begin training at the numbers that the diagnosis found, of fields and frictions."""
        known = {name: float(number["value"]) for name, number in numbers.items()}
        field = self.length / self.seconds**2
        rate = {"linear": 1 / self.seconds, "square": 1 / self.length, "dry": field}
        for part in head.modules():
            if isinstance(part, UniformField):
                found = [known.get(f"uniform: {name}", 0.0) / field for name in "xyz"]
                part.start_at(found[: len(part.acceleration)])
            elif isinstance(part, Friction) and f"{part.law}: rate" in known:
                part.start_at(known[f"{part.law}: rate"] / rate[part.law])


@dataclass(frozen=True)
class Trained:
    """A model with its forecast of the frames that it was not trained on.

    Args:
        head: of the specified terms, in its own units.
        units: those.
        error: root mean squared distance on those frames, in the unit of the tracks; ``None``
            where there are none.
        still: the same for a body that stays where it last was.
    """

    head: Head
    units: Units
    error: float | None
    still: float | None


def train_specified(
    term: HeadTerm,
    held: Mapping[str, Any],
    motion: Motion,
    end: int,
    steps: int,
    seed: int,
    progress: Progress | None = None,
) -> Trained:
    """Train a model of these terms on the frames before ``end``, and roll it over the rest.

    Args:
        term, held: see :func:`vidphys.diagnose.explanations.specification.read_specification`.
        motion: the tracks; frames that are not evenly spaced are read off a spline at even times.
        end: frame to stop before.
        steps: optimiser steps.
        seed: of initial weights and batch order.
        progress: called as ``(step, steps, loss)``.

    Raises:
        InputError: tracks of another scene, or a heat bath.
    """
    _check(term, held, motion)
    motion, end = _evened(motion, end)
    units = Units.of(motion)
    origin = np.asarray(held["origin"]) / units.length
    motion, term = units.motion(motion), term.counted_in(units.length, units.seconds)
    mass = torch.tensor(held.get("mass", [1.0] * motion.bodies)).expand(motion.clips, -1)
    coupling = np.ones(motion.clips) if motion.coupling is None else motion.coupling
    params = Parameters(torch.tensor(coupling).float(), mass.float())
    positions = torch.from_numpy(np.nan_to_num(motion.positions - origin)).float()
    sure = torch.from_numpy(motion.seen).float()
    times = torch.from_numpy(motion.times[0])
    tracks = Tracks(positions[:, :end], sure[:, :end], times[:end])
    torch.manual_seed(seed)
    head = build(term, motion.bodies, model_step(motion.interval)[0], motion.space)
    task = TrackTask(
        tracks, params, motion.interval, steps, seed, AHEAD, PRECISE, progress=progress
    )
    tell_scale(head, task)
    units.start(head, held["numbers"])
    train_by_shooting(head, task)
    if end >= motion.positions.shape[1]:
        return Trained(head, units, None, None)
    error, still = _foretold(head, positions, sure, params, motion.interval, end)
    return Trained(head, units, units.length * error, units.length * still)


def _check(term: HeadTerm, held: Mapping[str, Any], motion: Motion) -> None:
    if (motion.bodies, motion.space) != (held["bodies"], held["space"]):
        raise InputError(
            f"fit: the specification is of {held['bodies']} bodies in {held['space']} "
            f"dimensions, the tracks are of {motion.bodies} in {motion.space}"
        )
    if any(isinstance(part, Bath) for part in term.parts()):
        raise InputError("fit: a heat bath is not learned from tracks, only its rate is known")


def _evened(motion: Motion, end: int) -> tuple[Motion, int]:
    """The motion at even times, and the frame there before which the frame ``end`` lies."""
    gaps = np.diff(motion.times, axis=1)
    if np.abs(gaps - motion.interval).max() <= EVEN * motion.interval:
        return motion, end
    even = evened(motion)
    since = motion.times[:, end - 1] - motion.times[:, 0]
    return even, min(int(since.max() / motion.interval) + 1, even.positions.shape[1])


def _foretold(
    head: Head,
    positions: torch.Tensor,
    sure: torch.Tensor,
    params: Parameters,
    interval: float,
    end: int,
) -> tuple[float, float]:
    """Root mean squared distances in the tail: of the model, and of a body last seen that stays."""
    times = interval * torch.arange(end)
    start = by_shooting(head, Tracks(positions[:, :end], sure[:, :end], times), params, interval)
    dt, every = model_step(interval)
    ahead = positions.shape[1] - end
    rolled = rollout(head, start, params, ahead * every, dt, every).states.q[:, 1:]
    seen, weight = positions[:, end:], sure[:, end:]

    def error(path: torch.Tensor) -> float:
        squared = ((path - seen) ** 2).sum(-1)
        return float(((squared * weight).sum() / weight.sum()).sqrt())

    last = (sure[:, :end] * torch.arange(1, end + 1)[:, None]).argmax(1)  # frame, of each body
    still = positions[torch.arange(len(last))[:, None], last, torch.arange(last.shape[1])]
    return error(rolled), error(still[:, None].expand_as(seen))
