"""What moves in a real clip, by which law, and where it goes after the last frame.

One body on a curve: its place along the curve is the coordinate, the mass is one, and the model
has what such a scene requires: a potential, and friction because real swings die out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from binders import Tracks
from dynamics import (
    Hamiltonian,
    HamiltonianTerms,
    Head,
    Parameters,
    PhaseState,
    ResidualTerms,
    Terms,
    build,
)
from dynamics.ports import LinearFriction
from readouts.differencing import central_difference
from readouts.shooting import shoot
from vidphys.errors import InputError
from vidphys.initial_state import frame_roll
from vidphys.perception.base import model_step
from vidphys.segments import roll
from vidphys.track_training import TrackTask, tell_scale, train_by_shooting
from vidphys.train import Progress

HEADS: dict[str, Terms] = {
    "damped": HamiltonianTerms(potential="free", width=32, ports=("linear-friction",)),
    "unstructured": ResidualTerms(width=64),
}
SAMPLING = 0.1  # seconds between the positions that a head is trained on
AHEAD = 8  # positions predicted after the two that start a window
WINDOW_SECONDS = 1.5
PRECISE = 0.1  # coordinate units
STEPS = 400
BEND = 3  # degree of the curve


@dataclass(frozen=True)
class Curve:
    """A smooth curve in the picture, and the coordinate along it (unit: its spread in training).

    Args:
        centre, axis: of the principal direction, ``(2,)`` each, normalised image units.
        scale: normalised image units of one coordinate unit.
        bend: polynomial of the offset across the axis, highest power first.
    """

    centre: np.ndarray
    axis: np.ndarray
    scale: float
    bend: np.ndarray

    @classmethod
    def through(cls, positions: Tensor) -> Curve:
        """Fit the curve to positions ``(t, 2)``."""
        points = positions.double().numpy()
        centre = points.mean(0)
        axis = np.linalg.svd(points - centre, full_matrices=False)[2][0]
        along = (points - centre) @ axis
        scale = float(along.std())
        if not scale > 0:
            raise InputError("train: the body does not move in the training part of the clip")
        bend = np.polyfit(along / scale, (points - centre) @ _across(axis), BEND)
        return cls(centre, axis, scale, bend)

    def coordinate(self, positions: Tensor) -> Tensor:
        """``(..., 2)`` normalised image units to ``(..., 1)``."""
        along = (positions.double().numpy() - self.centre) @ self.axis / self.scale
        return torch.from_numpy(along).unsqueeze(-1)

    def place(self, coordinate: Tensor) -> Tensor:
        """Inverse of :meth:`coordinate` on the curve, ``(..., 1)`` to ``(..., 2)``."""
        s = coordinate.double().numpy()
        offset = np.polyval(self.bend, s)
        return torch.from_numpy(
            self.centre + self.scale * s * self.axis + offset * _across(self.axis)
        )


def _across(axis: np.ndarray) -> np.ndarray:
    return np.array([-axis[1], axis[0]])


@dataclass(frozen=True)
class Forecast:
    """A head fitted to the first part of a clip, and its rollout from there on.

    Args:
        head: the trained model.
        times: seconds, from the last training frame to past the end of the clip.
        positions: ``(r, 1, 2)`` normalised image units at those times.
        friction: per second, where the model has any.
    """

    head: Head
    times: Tensor
    positions: Tensor
    friction: float | None


def forecast(
    name: str, track: Tracks, end: int, beyond: float, seed: int, progress: Progress | None = None
) -> Forecast:
    """Fit a head to the frames before ``end`` and roll it on.

    Args:
        name: of :data:`HEADS`.
        track: positions ``(1, t, 1, 2)`` over the whole clip, normalised image units; those from
            ``end`` on are not looked at.
        end: first frame that is not trained on.
        beyond: seconds to roll past the last frame.
        seed: of initial weights and batch order.
        progress: called as ``(step, steps, loss)``.

    Raises:
        InputError: more than one body.
    """
    if track.positions.shape[2] != 1:
        raise InputError(
            f"train: the dynamics of a clip are fitted for one body, got "
            f"{track.positions.shape[2]}; use --bodies 1"
        )
    curve = Curve.through(track.positions[0, :end, 0])
    frame = float(track.times.diff().median())
    every = max(1, round(SAMPLING / frame))
    samples = _phases(curve.coordinate(track.positions[:, :end]), track.confidence, every, end)
    interval = every * frame
    dt, _ = model_step(interval)
    torch.manual_seed(seed)
    head = build(HEADS[name], bodies=1, dt=dt, space=1)
    params = _unit(len(samples.positions))
    task = TrackTask(samples, params, interval, STEPS, seed, AHEAD, PRECISE, progress=progress)
    tell_scale(head, task)
    train_by_shooting(head, task)
    start = _last_state(head, samples, interval)
    ahead = float(track.times[-1] - track.times[end - 1]) + beyond
    with torch.no_grad():
        later = roll(head, start, _unit(1), round(ahead / dt), dt, 1)
    coordinate = torch.cat([start.q[0], later.q[0, :, 0]], 0)
    times = track.times[end - 1] + dt * torch.arange(len(coordinate), dtype=torch.float64)
    return Forecast(head, times, curve.place(coordinate).unsqueeze(1), _friction(head))


def _friction(head: Head) -> float | None:
    if not isinstance(head, Hamiltonian):
        return None
    rates = [float(port.rate.detach()) for port in head.ports if isinstance(port, LinearFriction)]
    return rates[0] if rates else None


def _phases(coordinate: Tensor, confidence: Tensor, every: int, end: int) -> Tracks:
    """Every ``every``-th frame, once from each offset, all ending as late as they can."""
    frames = end // every
    at = [
        torch.arange(end - offset - (frames - 1) * every - 1, end - offset, every)
        for offset in range(every)
    ]
    positions = torch.cat([coordinate[:, index] for index in at])
    sure = torch.cat([confidence[:, index] for index in at])
    return Tracks(positions, sure, torch.arange(frames, dtype=torch.float64))


def _unit(episodes: int) -> Parameters:
    return Parameters(torch.ones(episodes), torch.ones(episodes, 1))


def _last_state(head: Head, samples: Tracks, interval: float) -> PhaseState:
    """The state at the last training frame, fitted through the head over a window."""
    window = min(samples.positions.shape[1], round(WINDOW_SECONDS / interval))
    positions = samples.positions[:1, -window:].float()
    first = central_difference(positions, torch.ones(1, 1), interval)[:, 0]
    guess = PhaseState(positions[:, 0], first.p)
    with torch.no_grad():
        fitted = shoot(frame_roll(head, _unit(1), interval), positions, guess)
    return fitted.states[:, -1]


def forecast_error(times: Tensor, positions: Tensor, track: Tracks, frames: Tensor) -> float:
    """Root mean squared distance (normalised image units) from a track at given frames.

    Args:
        times, positions: of a rollout, ``(r,)`` and ``(r, 1, 2)``.
        track: what is compared with, ``(1, t, 1, 2)``; frames it is not sure of do not count.
        frames: numbers of the compared frames.
    """
    at, seen = track.times[frames].numpy(), track.positions[0, frames, 0].double()
    weight = track.confidence[0, frames, 0].double()
    path = positions[:, 0].double().numpy()
    guess = torch.from_numpy(
        np.stack([np.interp(at, times.numpy(), path[:, axis]) for axis in range(2)], -1)
    )
    squared = (guess - seen).square().sum(-1)
    return float(((weight * squared).sum() / weight.sum()).sqrt())


def naive_forecasts(track: Tracks, end: int) -> dict[str, tuple[Tensor, Tensor]]:
    """What a forecast must beat: stay where it was, and keep the last speed."""
    times = track.times[end - 1 :]
    last = track.positions[0, end - 1 : end].double()
    speed = central_difference(
        track.positions[:, end - 3 : end].double(), torch.ones(1, 1).double(), 1.0
    ).p[0]
    steps = torch.arange(len(times), dtype=torch.float64)[:, None, None]
    return {
        "persistence": (times, last.expand(len(times), -1, -1)),
        "constant-velocity": (times, last + steps * speed),
    }
