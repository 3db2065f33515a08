"""Which push takes a body where it shall be, as a trained model has it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dynamics import Head, Parameters, PhaseState, rollout
from vidphys.errors import InputError
from vidphys.shooting.impulse import kicked, plan_impulse, search_impulse

SLOPES = "slopes"
SEARCHES = {SLOPES: plan_impulse, "cross-entropy": search_impulse}
GENEROUS = 10.0  # times the speed of a straight line, where no limit is given
PROBE = 0.1  # momentum units, to see what a push does to the speed

Place = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Aim:
    """Where a body shall be.

    Args:
        target: in the unit of the tracks ``(d,)``.
        body: its number, from 0.
        most: largest change of its speed, in that unit a second; ``None`` for ten times
            what would make up for the miss on a straight line.
        search: how a push is looked for, one of :data:`SEARCHES`.
    """

    target: tuple[float, ...]
    body: int = 0
    most: float | None = None
    search: str = SLOPES


@dataclass(frozen=True)
class Push:
    """What was found.

    Args:
        state: the start with the push.
        change: of the body's velocity, in the unit of the tracks a second, ``(d,)``.
        idle: distance to the target without a push.
        left: with it, as the model says.
        bound: whether it is as strong as it may be.
    """

    state: PhaseState
    change: np.ndarray
    idle: float
    left: float
    bound: bool


@dataclass(frozen=True)
class Way:
    """How a model gets from a state to places.

    Args:
        head: the model.
        law: batch of one.
        dt: of a step, in the model's own unit of time.
        place: from its coordinates ``(..., n, d)`` to the unit of the tracks.
        unit: seconds in that unit of time.
    """

    head: Head
    law: Parameters
    dt: float
    place: Place
    unit: float = 1.0

    def after(self, steps: int, states: PhaseState) -> Tensor:
        """Places of all bodies so many steps later, ``(b, n, d)``, in float64."""
        law = self.law.map(lambda x: x.expand(len(states.q), *x.shape[1:]))
        states = states.map(lambda x: x.to(law.mass.dtype))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the path that is taken in the end is told of
            rolled = rollout(self.head, states, law, steps, self.dt, steps)
        return self.place(rolled.states.q[:, -1].double())


def steer(way: Way, start: PhaseState, steps: int, aim: Aim) -> Push:
    """The push at the start after which a body is nearest to its target.

    Args:
        way: of the model.
        start: batch of one.
        steps: of the model until the body shall be there.
        aim: which body, and where.

    Raises:
        InputError: no such body, another number of coordinates, or a limit that is not positive.
    """
    start = start.map(torch.Tensor.double)
    there = way.after(steps, start)
    bodies, space = there.shape[-2:]
    if not 0 <= aim.body < bodies:
        raise InputError(f"`body` {aim.body + 1}: there are {bodies}")
    if len(aim.target) != space:
        raise InputError(f"`reach`: {len(aim.target)} numbers given, a place here has {space}")
    if aim.most is not None and not aim.most > 0:
        raise InputError(f"`most` {aim.most:g}: must be above 0")
    target = torch.tensor([aim.target], dtype=torch.float64)
    idle = float((there[:, aim.body] - target).norm())
    seconds = steps * way.dt * way.unit
    most = aim.most or GENEROUS * idle / seconds
    effect = _effect(way, start, aim.body)
    strongest = float(torch.linalg.matrix_norm(effect, 2))
    if not strongest > 0:
        raise InputError(f"`body` {aim.body + 1}: no push moves it")
    plan = SEARCHES[aim.search](
        lambda states: way.after(steps, states)[:, aim.body],
        start,
        target,
        most / strongest,
        aim.body,
    )
    change = (effect @ plan.impulse[0]).numpy()
    bound = float(plan.impulse.norm()) > 0.999 * most / strongest
    return Push(kicked(start, plan.impulse, aim.body), change, idle, float(plan.error), bound)


def _effect(way: Way, start: PhaseState, body: int) -> Tensor:
    """What a push does to a body's velocity as it is seen, ``(d, impulse)``."""
    probes = torch.cat([torch.zeros(1, start.p.shape[-1]), PROBE * torch.eye(start.p.shape[-1])])
    states = kicked(start, probes.double()[:, None], body).map(lambda x: x.flatten(0, 1))
    seen = way.after(1, states)[:, body]
    return (seen[1:] - seen[0]).T / (PROBE * way.dt * way.unit)
