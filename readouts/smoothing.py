"""The states of a window under dynamics that are nearly right: weak-constraint smoothing.

Every frame's state is an unknown. It is to lie near the observed positions, and near where the
dynamics carry the frame before; how near, the *slack* says. A start state alone would have to fit
a chaotic window through all its encounters at once; with slack each frame is fitted through one
step, and as the slack is drawn in, the states become one rollout. Observations count as in a
Cauchy likelihood: a position that nothing explains is let go.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from dynamics.state import PhaseState

Step = Callable[[PhaseState, Tensor], PhaseState]

ROUNDS = 25  # of Levenberg-Marquardt for each slack, at most; most windows need four
SETTLED = 1e-3  # a relative gain below it ends them
STUCK = 1e4  # so does damping above this
OUTLYING = 2.0  # expected errors: beyond, a position counts less and less
NUDGE = 1e-6  # by which a state is moved for a derivative


@dataclass(frozen=True)
class Smoothed:
    """The window under one slack.

    Args:
        states: at every frame, ``(b, t, n, d)``.
        cost: minus twice the log likelihood of a frame, ``(b,)``: about one for each number that
            was observed; infinite where the dynamics could not be rolled.
    """

    states: PhaseState
    cost: Float[Tensor, " b"]


def smooth(
    step: Step,
    positions: Float[Tensor, "b t n d"],
    error: Float[Tensor, "b t n"],
    guess: PhaseState,
    interval: float,
    slacks: Sequence[float],
) -> Iterator[Smoothed]:
    """Fit the states of all frames, under each slack from the fit under the one before.

    Args:
        step: ``(starts (..., r, n, d), rows (r,)) -> states`` one frame later; the rows say which
            episodes they are of.
        positions: observed, world units, float64: derivatives are differences.
        error: that is expected of them, world units.
        guess: states at every frame, ``(b, t, n, d)``.
        interval: seconds between frames.
        slacks: standard deviations of momentum, falling; positions may miss by the slack times the
            interval (bodies of about unit mass).

    Raises:
        ValueError: fewer than three frames, or a position that is not finite.
    """
    if positions.shape[1] < 3:
        raise ValueError(
            f"smooth: momentum needs at least 3 frames, got {positions.shape[1]}; use more"
        )
    if not bool(torch.isfinite(positions).all()):
        raise ValueError("smooth: positions must be finite; drop or fill the frames that are not")
    problem = _Problem(step, positions, error, interval)
    x = torch.cat([guess.q.flatten(2), guess.p.flatten(2)], -1).to(positions)
    for slack in slacks:
        x, cost = _minimise(problem, x, slack)
        yield Smoothed(problem.states(x), cost / positions.shape[1])


@dataclass(frozen=True)
class _Misses:
    """What is wrong with some states: of the dynamics, of the positions, and in all.

    Args:
        defect: over its deviation, ``(m, t - 1, k)``.
        residual: over the expected error, ``(m, t, n, d)``.
        carried: where the dynamics take each state but the last, ``(m, t - 1, k)``.
        cost: ``(m,)``.
    """

    defect: Tensor
    residual: Tensor
    carried: Tensor
    cost: Tensor

    def of(self, rows: Tensor) -> _Misses:
        """Those of some of the states."""
        return _Misses(self.defect[rows], self.residual[rows], self.carried[rows], self.cost[rows])


@dataclass(frozen=True)
class _Problem:
    """The fit as a function of the flat states of all frames, ``(m, t, k)``: positions first."""

    step: Step
    positions: Tensor
    error: Tensor
    interval: float

    def states(self, x: Tensor) -> PhaseState:
        n, d = self.positions.shape[2:]
        q, p = x.unflatten(-1, (2, n, d)).unbind(-3)
        return PhaseState(q, p)

    def carried(self, x: Tensor, rows: Tensor) -> Tensor:
        """Where the dynamics take states ``(..., m, t, k)`` in a frame."""
        later = self.step(self.states(x.movedim(-2, 0)), rows)
        return torch.stack([later.q, later.p], -3).flatten(-3).movedim(0, -2)

    def deviation(self, slack: float) -> Tensor:
        """Of a state's numbers from where the dynamics take it, ``(k,)``."""
        half = self.positions.shape[2] * self.positions.shape[3]
        momentum = self.positions.new_full((half,), slack)
        return torch.cat([momentum * self.interval, momentum])

    def misses(self, x: Tensor, rows: Int[Tensor, " m"], slack: float) -> _Misses:
        carried = self.carried(x[:, :-1], rows)
        defect = (x[:, 1:] - carried) / self.deviation(slack)
        residual = (self.states(x).q - self.positions[rows]) / self.error[rows, ..., None]
        unlikely = OUTLYING**2 * (residual.square().sum(-1) / OUTLYING**2).log1p()
        cost = defect.square().flatten(1).sum(1) + unlikely.flatten(1).sum(1)
        cost = torch.where(torch.isfinite(cost), cost, torch.inf)
        return _Misses(defect, residual, carried, cost)

    def normal(
        self, x: Tensor, rows: Tensor, slack: float, missed: _Misses
    ) -> tuple[Tensor, Tensor]:
        """Normal matrix ``(m, t k, t k)`` and half of the gradient ``(m, t k)``."""
        m, t, k = x.shape
        nudged = x[:, :-1] + NUDGE * torch.eye(k).to(x)[:, None, None]
        deviation = self.deviation(slack)
        slope = ((self.carried(nudged, rows) - missed.carried) / NUDGE).movedim(0, -1)
        slope = slope / deviation[:, None]
        trust = 1 / (1 + missed.residual.square().sum(-1, keepdim=True) / OUTLYING**2)
        pull = trust / self.error[rows, ..., None]
        weight = (pull / self.error[rows, ..., None]).expand_as(missed.residual).flatten(2)
        nothing = torch.zeros_like(weight)
        matrix, frame = x.new_zeros(m, t, t, k, k), torch.arange(t)
        before, after = frame[:-1], frame[1:]
        matrix[:, frame, frame] += torch.diag_embed(torch.cat([weight, nothing], -1))
        matrix[:, before, before] += slope.mT @ slope
        matrix[:, after, after] += torch.diag(deviation**-2)
        matrix[:, before, after] -= slope.mT / deviation
        matrix[:, after, before] -= slope / deviation[:, None]
        gradient = torch.cat([(pull * missed.residual).flatten(2), nothing], -1)
        gradient[:, 1:] += missed.defect / deviation
        gradient[:, :-1] -= (slope.mT @ missed.defect.unsqueeze(-1)).squeeze(-1)
        return matrix.transpose(2, 3).reshape(m, t * k, t * k), gradient.flatten(1)


def _minimise(problem: _Problem, x: Tensor, slack: float) -> tuple[Tensor, Tensor]:
    """Levenberg-Marquardt, each episode with its own damping and its own end."""
    x, rows = x.clone(), torch.arange(len(x), device=x.device)
    damping = torch.full_like(x[:, 0, 0], 1e-3)
    missed = problem.misses(x, rows, slack)
    cost = missed.cost.clone()
    matrix, gradient = problem.normal(x, rows, slack, missed)
    for _ in range(ROUNDS):
        usable = torch.isfinite(matrix).flatten(1).all(1) & torch.isfinite(gradient).all(1)
        usable &= torch.isfinite(cost[rows])
        rows, matrix, gradient = rows[usable], matrix[usable], gradient[usable]
        if not len(rows):
            break
        ridge = damping[rows, None] * matrix.diagonal(dim1=1, dim2=2)
        move = torch.linalg.solve(matrix + torch.diag_embed(ridge), gradient)
        trial = x[rows] - move.unflatten(1, x.shape[1:])
        missed = problem.misses(trial, rows, slack)
        gained = missed.cost < cost[rows]
        slight = gained & (cost[rows] - missed.cost < SETTLED * missed.cost)
        x[rows[gained]], cost[rows[gained]] = trial[gained], missed.cost[gained]
        damping[rows] *= torch.where(gained, 0.1, 10.0).to(damping)
        left = ~slight & (damping[rows] < STUCK)
        # Where nothing was gained, the states are those that were differentiated before.
        moved, again = gained[left], gained & left
        rows, matrix, gradient = rows[left], matrix[left], gradient[left]
        if bool(moved.any()):
            found = problem.normal(trial[again], rows[moved], slack, missed.of(again))
            matrix[moved], gradient[moved] = found
    return x, cost
