"""Laws with few numbers, fitted by least squares to all positions of long stretches at once.

Windows of a few frames tell a force from its noise only where frames lie far apart. A law of few
numbers needs none of their many starts: it is rolled over whole stretches, and its numbers are
found together with the stretches' start states.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import least_squares
from torch import Tensor

from binders import Tracks
from dynamics import Head, Parameters, PhaseState
from vidphys.progress import Progress
from vidphys.shooting.step import roll

MANY = 64  # numbers, from which on it is a network's
NUDGE = 1e-6
# Unit seconds of a stretch, one after the other, and the unit length from which on an error counts
# by its size and not its square: a rough start is no outlier.
SPANS = ((3.0, 0.5), (12.0, 0.05))
APART = 0.04  # unit seconds between the frames that are compared, at least
BENT = 0.5  # unit seconds in which a path is as good as a parabola
LEAST = 6  # frames of a stretch
STEP = 0.04  # unit seconds at most: what swings once in 2 pi is off by a part in ten thousand
DONE = 1e-5  # share by which a round must still change something


def is_few(head: Head) -> bool:
    """Whether a model has so few numbers that all of them are found at once."""
    return sum(parameter.numel() for parameter in head.parameters()) < MANY


@dataclass(frozen=True)
class Stretches:
    """Pieces of equal length that end with the tracks.

    Args:
        positions: ``(w, l, n, d)``, float64.
        weight: 1 where a body was seen, ``(w, l, n)``.
        params: of each at its first frame, ``(w,)``.
        interval: between their frames, unit seconds.
    """

    positions: Tensor
    weight: Tensor
    params: Parameters
    interval: float

    @classmethod
    def of(cls, tracks: Tracks, params: Parameters, interval: float, span: float) -> Stretches:
        """Pieces of about this many unit seconds, of frames that lie as far apart as is enough.

        Args:
            tracks, interval: see :func:`fit_few`.
            params: of each clip at its last frame.
            span: unit seconds.
        """
        every = max(1, round(APART / interval))
        frames = tracks.positions.shape[1]
        every = max(1, min(every, frames // LEAST))
        length = min(max(LEAST, round(span / (every * interval))), frames // every)
        count = frames // (every * length)
        at = torch.arange(frames - 1, frames - 1 - every * length * count, -every).flip(0)

        def cut(x: Tensor) -> Tensor:
            return x[:, at].unflatten(1, (count, length)).flatten(0, 1).double()

        law = params.map(lambda x: x.double().repeat_interleave(count, 0))
        since = interval * (at.reshape(count, length)[:, 0] - (frames - 1)).double()
        law = law.later(since.repeat(len(params.mass)))
        seen = (tracks.confidence > 0).to(tracks.positions)
        return cls(cut(tracks.positions), cut(seen), law, every * interval)

    def guess(self) -> PhaseState:
        """States at the first frames, by parabolas through what was seen in the frames after."""
        few = min(self.positions.shape[1], max(LEAST, round(BENT / self.interval)))
        since = self.interval * torch.arange(few, dtype=torch.float64)
        powers = torch.stack([torch.ones_like(since), since, since.square()], -1)
        weight = self.weight[:, :few].transpose(1, 2).unsqueeze(-1)  # (w, n, few, 1)
        places = self.positions[:, :few].transpose(1, 2)
        solved = torch.linalg.pinv(weight * powers) @ (weight * places)
        return PhaseState(solved[..., 0, :], self.params.mass.unsqueeze(-1) * solved[..., 1, :])


class _Problem:
    """Residuals and their slopes, in the numbers of a model and the states that stretches start."""

    def __init__(self, head: Head, data: Stretches) -> None:
        self.head, self.data = head, data
        self.numbers = [p for p in head.parameters() if p.requires_grad]
        self.count = sum(p.numel() for p in self.numbers)
        self.every = max(1, math.ceil(data.interval / STEP - 1e-6))
        self.dt = data.interval / self.every
        self.shape = data.positions[:, 0].shape  # (w, n, d)
        self.own = 2 * self.shape[1:].numel()  # unknowns of one stretch

    def first(self) -> np.ndarray:
        start = self.data.guess()
        flat = [p.detach().flatten() for p in self.numbers]
        return torch.cat([*flat, start.flat.flatten()]).numpy()

    def state(self, x: np.ndarray) -> PhaseState:
        flat = torch.from_numpy(x[self.count :]).reshape(len(self.data.positions), -1)
        return PhaseState.from_flat(flat, *self.shape[1:])

    def put(self, x: np.ndarray) -> None:
        """Let the model have these numbers."""
        at = 0
        for number in self.numbers:
            with torch.no_grad():
                number.copy_(torch.from_numpy(x[at : at + number.numel()]).reshape(number.shape))
            at += number.numel()

    def residuals(self, x: np.ndarray) -> np.ndarray:
        self.put(x)
        return self._missed(self.state(x), self.data.params).flatten().numpy()

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """The Jacobian ``(w l n d, unknowns)``: number after number, then all starts at once."""
        here, columns = self.residuals(x), []
        for k in range(self.count):
            there = x.copy()
            there[k] += NUDGE * max(1.0, abs(x[k]))
            columns.append((self.residuals(there) - here) / (there[k] - x[k]))
        self.put(x)
        start = self.state(x).flat
        moved = start + NUDGE * torch.eye(self.own, dtype=start.dtype)[:, None]
        law = self.data.params.map(lambda y: y.expand(self.own, *y.shape))
        missed = self._missed(PhaseState.from_flat(moved, *self.shape[1:]), law)
        change = (missed - torch.from_numpy(here).reshape(missed.shape[1:])) / NUDGE
        blocks = change.flatten(2).permute(1, 2, 0)  # (w, l n d, own)
        whole = torch.block_diag(*blocks).numpy()
        return np.concatenate([np.stack(columns, 1), whole], 1) if columns else whole

    def _missed(self, start: PhaseState, law: Parameters) -> Tensor:
        with torch.no_grad():
            steps = self.data.positions.shape[1] - 1
            later = roll(self.head, start, law, steps, self.dt, self.every).q
        path = torch.cat([start.q.unsqueeze(-3), later], -3)
        off = (path - self.data.positions).nan_to_num(nan=1e3, posinf=1e3, neginf=-1e3)
        return off.clamp(-1e3, 1e3) * self.data.weight.unsqueeze(-1)


def fit_few(
    head: Head,
    tracks: Tracks,
    params: Parameters,
    interval: float,
    rounds: int,
    progress: Progress | None = None,
) -> None:
    """Fit the numbers of a model, in place, on short stretches first and then on longer ones.

    Args:
        head: that conserves or loses energy, without noise.
        tracks: in the units that the model counts in.
        params: of each clip at its last frame.
        interval: unit seconds between frames.
        rounds: of the least squares, at most, for each length.
        progress: called as ``(step, steps, loss)``.
    """
    close = copy.deepcopy(head).double()
    if not any(p.requires_grad for p in close.parameters()):
        return
    for k, (span, rough) in enumerate(SPANS):
        _solved(close, Stretches.of(tracks, params, interval, span), rough, rounds)
        if progress is not None:
            progress(k + 1, len(SPANS), 0.0)
    head.load_state_dict(close.state_dict())


def last_state(head: Head, tracks: Tracks, params: Parameters, interval: float) -> PhaseState:
    """The state at the last frame, of the path of a model that comes nearest to a long stretch.

    Args:
        head, tracks, params, interval: see :func:`fit_few`.
    """
    close = copy.deepcopy(head).double()
    span, rough = SPANS[-1]
    data = Stretches.of(tracks, params, interval, span)
    each = len(data.positions) // len(tracks.positions)
    ends = slice(each - 1, None, each)  # the last stretch of each clip
    data = Stretches(data.positions[ends], data.weight[ends], data.params[ends], data.interval)
    close.requires_grad_(False)
    start = _solved(close, data, rough, ROUNDS)
    problem = _Problem(close, data)
    with torch.no_grad():
        steps = data.positions.shape[1] - 1
        path = roll(close, start, data.params, steps, problem.dt, problem.every)
    return path.map(lambda x: x[:, -1].float())


ROUNDS = 30  # for a start state alone


def _solved(head: Head, data: Stretches, rough: float, rounds: int) -> PhaseState:
    """The stretches' start states, and with them what a model learns, in place."""
    problem = _Problem(head, data)
    found = least_squares(
        problem.residuals,
        problem.first(),
        problem.slopes,
        loss="soft_l1",
        f_scale=rough,
        x_scale="jac",
        max_nfev=rounds,
        ftol=DONE,
        xtol=DONE,
    )
    problem.put(found.x)
    return problem.state(found.x)
