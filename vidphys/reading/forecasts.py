"""Where what moves in a clip goes after a frame, and how wrong that was."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from binders import Tracks
from dynamics import Head, Parameters, PhaseState, rollout
from dynamics.compiled import Report, form_of
from readouts.differencing import central_difference
from vidphys.data.evenness import JITTER, evenly, jitter
from vidphys.errors import InputError
from vidphys.reading.clip_dynamics import Dynamics, Followed
from vidphys.reading.steering import Aim, Push, Way, steer
from vidphys.shooting.initial_state import by_shooting

SAME_RATE = 0.02


@dataclass(frozen=True)
class Ran:
    """What computed a rollout: the trained model as it is, or a spline that stands for it.

    Args:
        backend: see :class:`dynamics.head.Trajectory`.
        spline: how near its force is, and how near it had to be; ``None`` without one.
        why: there is none, in words.
    """

    backend: str
    spline: Report | None
    why: str


@dataclass(frozen=True)
class Forecast:
    """A rollout in the picture.

    Args:
        times: seconds ``(r,)``, from the frame that it starts at.
        positions: world units ``(r, n, 2)``, as seen by a camera without drift.
        findings: what is wrong with it, in words.
        push: that a body was given at the start, where one was looked for.
        ran: what computed it, where a model did.
    """

    times: Tensor
    positions: Tensor
    findings: tuple[str, ...] = ()
    push: Push | None = None
    ran: Ran | None = None


def state_at(head: Head, clip: Followed, end: int, dynamics: Dynamics) -> PhaseState:
    """The state at frame ``end - 1``, fitted through the head over the samples that lead to it.

    Args:
        head: one of the dynamics'.
        clip: what was followed.
        end: frames that may be looked at.
        dynamics: says how far samples are apart, and in which coordinates they are.

    Raises:
        InputError: fewer than three samples, or frames that do not meet the samples' interval.
    """
    interval, chart = dynamics.interval, dynamics.chart
    clip = clip.until(end)
    end, frame = len(clip.track.times), float(clip.track.times.diff().median())
    every = max(1, round(interval / frame))
    if abs(every * frame / interval - 1) > SAME_RATE:
        raise InputError(
            f"{1 / frame:.4g} frames per second do not meet the {interval:.4g} s between the "
            "samples that this run was trained on; convert the clip to the rate of the training's"
        )
    at = torch.arange((end - 1) % every, end, every)
    if len(at) < 3:
        raise InputError(
            f"{end} frames are {len(at)} samples {interval:.3g} s apart; a start state needs three"
        )
    tracks = Tracks(
        chart.coordinate(clip.track.positions[:, at]),
        clip.track.confidence[:, at],
        clip.track.times[at],
    )
    return by_shooting(head, tracks, clip.law, interval)


def forecast(
    head: Head,
    start: PhaseState,
    law: Parameters,
    dynamics: Dynamics,
    began: float,
    seconds: float,
    aim: Aim | None = None,
) -> Forecast:
    """Roll a model on.

    Args:
        head: one of the dynamics', or one of these with a term taken out.
        start: coordinates of the chart, batch of one.
        law: that is to hold, batch of one.
        dynamics: of the coordinates and the step.
        began: time of the start.
        seconds: to roll.
        aim: look for a push at the start that takes a body somewhere by then, and roll with it.
    """
    dt, law = dynamics.dt, law.map(torch.Tensor.float)
    steps, push = max(1, round(seconds / dt)), None
    if aim is not None:
        push = steer(Way(head, law, dt, dynamics.chart.place), start, steps, aim)
        start = push.state.map(lambda x: x.to(law.mass.dtype))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        form = form_of(head, start, law, steps, dt)
        rolled = rollout(form.head, start, law, steps, dt)
    coordinates = rolled.states.q[0]
    times = began + dt * torch.arange(len(coordinates), dtype=torch.float64)
    said = tuple(" ".join(str(each.message).split()) for each in found)
    ran = Ran(rolled.backend, rolled.report, form.why)
    return Forecast(times, dynamics.chart.place(coordinates), said, push, ran)


def forecast_error(found: Forecast, track: Tracks, frames: Tensor) -> float:
    """Root mean squared distance (world units) from a track at given frames, over all bodies.

    Args:
        found: what was foretold.
        track: what is compared with, ``(1, t, n, 2)``; frames it is not sure of do not count.
        frames: numbers of the compared frames.
    """
    at = track.times[frames].numpy()
    seen, weight = track.positions[0, frames].double(), track.confidence[0, frames].double()
    path = found.positions.double().flatten(1).numpy()
    guess = np.stack([np.interp(at, found.times.numpy(), column) for column in path.T], -1)
    squared = (torch.from_numpy(guess).reshape_as(seen) - seen).square().sum(-1)
    return float(((weight * squared).sum() / weight.sum()).sqrt())


def naive_forecasts(track: Tracks, end: int) -> dict[str, Forecast]:
    """What a forecast must beat: stay where it was, and keep the last speed."""
    times = track.times[end - 1 :]
    last = track.positions[0, end - 1 : end].double()
    even = evenly(track, end)
    recent = even.positions[:, -3:].double()
    mass = torch.ones(1, recent.shape[2]).double()
    speed = central_difference(recent, mass, 1.0).p[0]
    steps = torch.arange(len(times), dtype=torch.float64)[:, None, None]
    if jitter(track.times.double().numpy()) > JITTER:
        steps = ((times - times[0]) / even.times.diff().median())[:, None, None]
    return {
        "persistence": Forecast(times, last.expand(len(times), -1, -1)),
        "constant-velocity": Forecast(times, last + steps * speed),
    }
