"""A rollout cut up, so that whoever waits for it can stop it between two pieces."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial

import torch
from torch import Tensor

from dynamics import DynamicsWarning, Parameters, PhaseState, Rollout
from dynamics.findings import Finding
from dynamics.rolling import first_bad_step

WAIT = 0.008  # seconds that a piece of a rollout should take: for so long a new change waits
MOST_PIECES = 40  # of a rollout, whose checks each piece repeats
SLOW = 0.016  # seconds of a piece, beside which its checks are little
# (start, params, steps, every)
Roll = Callable[[PhaseState, Parameters, int, int], Rollout]


def in_pieces(
    roll: Roll,
    start: PhaseState,
    params: Parameters,
    steps: int,
    every: int,
    once: bool = False,
) -> Iterator[tuple[int, Rollout] | None]:
    """Rollouts one after the other, each with the number of its first stored state.

    Each goes on for about :data:`WAIT`, unless all are done at once; where that is less than from
    one stored state to the next, ``None`` comes in between. Episodes that are no longer finite stay
    behind, as NaN.
    """
    everyone, first, left, since = len(start.q), 0, steps, 0
    alive, state, pace = torch.arange(everyone), start, _Pace(-(-steps // MOST_PIECES))
    said, law = tuple[Finding, ...](), params
    while left and len(alive):
        began, size = time.perf_counter(), left if once else pace.size
        part = size < every or since > 0
        count = min(size, every - since) if part else min(size // every * every, left)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DynamicsWarning)  # they come with the result
            found = roll(state[alive], law[alive], count, count if part else every)
        whole = found.states.map(partial(_spread, alive=alive, everyone=everyone))
        state, said = whole.map(lambda x: x[:, -1]), said + found.findings
        law = law.later(float(found.times[-1]))
        left, since = left - count, (since + count) % every
        if since:
            yield None
        else:
            states = whole.map(lambda x: x[:, 1:]) if first else _after(start, whole)
            bad, dt = first_bad_step(states), found.dt * (every / count if part else 1)
            yield first, Rollout(states, params, dt, bad, None, said, 0, found.backend)
            first, said = first + states.q.shape[1], ()
        alive = torch.isfinite(state.flat).all(-1).nonzero().squeeze(-1)
        pace.took(count, max(time.perf_counter() - began, 1e-6))


class _Pace:
    """How many steps the next piece has, from what those before took.

    A piece takes a while for its checks, and more for each step. It is cut short for its steps
    alone: where the checks are slow, short pieces would make all of it slower.

    Args:
        least: steps of a piece, where they are quick.
    """

    def __init__(self, least: int) -> None:
        self.least, self.size = least, 1
        self._quickest, self._slope = (math.inf, 0), 0.0  # seconds and steps; seconds a step

    def took(self, count: int, seconds: float) -> None:
        """Hear how long a piece of so many steps took."""
        before, few = self._quickest
        if count > few and seconds > before:
            self._slope = (seconds - before) / (count - few)
        else:
            self._slope *= 0.9  # one slow piece among them is forgotten
        self._quickest = min(self._quickest, (seconds, count))
        slow = self._slope * self.least > SLOW
        least = max(1, round(WAIT / self._slope)) if slow else self.least
        self.size = max(round(min(4.0, WAIT / seconds) * count), min(4 * count, least))


def _after(start: PhaseState, states: PhaseState) -> PhaseState:
    """States ``(e, t, n, d)`` whose first is the start."""
    return PhaseState(
        *(torch.cat([getattr(start, x)[:, None], getattr(states, x)[:, 1:]], 1) for x in "qp")
    )


def _spread(x: Tensor, alive: Tensor, everyone: int) -> Tensor:
    if len(alive) == everyone:
        return x
    return x.new_full((everyone, *x.shape[1:]), torch.nan).index_copy(0, alive, x)
