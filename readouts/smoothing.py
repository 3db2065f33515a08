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

from dynamics import PhaseState

Step = Callable[[PhaseState, Tensor], PhaseState]

FREE = 2  # frames that some state passes through, whatever they show


@dataclass(frozen=True)
class SmoothingSettings:
    """Of the fit under one slack.

    Args:
        rounds: of Levenberg-Marquardt, at most; most windows need four.
        settled: a relative gain below it ends them.
        stuck: so does damping above this.
        outlying: expected errors; beyond, a position counts less and less.
        foretold: deviations; a slope that foretells a frame worse than that is found again.
    """

    rounds: int = 25
    settled: float = 1e-3
    stuck: float = 1e4
    outlying: float = 2.0
    foretold: float = 0.1


@dataclass(frozen=True)
class Smoothed:
    """The window under one slack.

    Args:
        states: at every frame, ``(b, t, n, d)``.
        cost: minus twice the log likelihood, for each frame beyond the two that fix a state,
            ``(b,)``: about one for each number that is observed of a frame, however long the
            window; infinite where the dynamics could not be rolled.
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
    settings: SmoothingSettings = SmoothingSettings(),
) -> Iterator[Smoothed]:
    """Fit the states of all frames, under each slack from the fit under the one before.

    Args:
        step: ``(starts (..., r, n, d), rows (r,)) -> states`` one frame later; the rows say which
            episodes they are of.
        positions: observed, world units, float64.
        error: that is expected of them, world units.
        guess: states at every frame, ``(b, t, n, d)``, in the precision that steps are taken in.
        interval: seconds between frames.
        slacks: standard deviations of momentum, falling; positions may miss by the slack times the
            interval (bodies of about unit mass).

    Raises:
        ValueError: fewer than three frames, or a position that is not finite.

    Example:
        >>> coast = lambda start, rows: PhaseState(start.q + 0.1 * start.p, start.p)
        >>> times = 0.1 * torch.arange(6, dtype=torch.float64)
        >>> noise = 0.01 * torch.tensor([1, -1, 0, 0, -1, 1.0])
        >>> seen = (2 * times + noise).reshape(1, 6, 1, 1)
        >>> guess = PhaseState(seen, torch.ones_like(seen))
        >>> error = torch.full((1, 6, 1), 0.01)
        >>> *_, last = smooth(coast, seen, error, guess, 0.1, slacks=[1.0, 0.1, 0.01])
        >>> [round(x, 1) for x in last.states.p.flatten().tolist()]
        [2.0, 2.0, 2.0, 2.0, 2.0, 2.0]
    """
    if positions.shape[1] < 3:
        raise ValueError(
            f"smooth: momentum needs at least 3 frames, got {positions.shape[1]}; use more"
        )
    if not bool(torch.isfinite(positions).all()):
        raise ValueError("smooth: positions must be finite; drop or fill the frames that are not")
    problem = _Problem(step, positions, error, interval, guess.q.dtype, settings)
    path = problem.path(torch.cat([guess.q.flatten(2), guess.p.flatten(2)], -1).to(positions))
    for slack in slacks:
        cost = _minimise(problem, path, slack)
        yield Smoothed(problem.states(path.x.clone()), cost / (positions.shape[1] - FREE))


@dataclass(frozen=True)
class _Path:
    """Flat states of all frames, positions first, and what the dynamics make of them.

    Args:
        x: ``(m, t, k)``.
        carried: where the dynamics take each state but the last, ``(m, t - 1, k)``.
        slope: nearly how that changes with the state, ``(m, t - 1, k, k)``.
    """

    x: Tensor
    carried: Tensor
    slope: Tensor

    def __getitem__(self, rows: Tensor) -> _Path:
        return _Path(self.x[rows], self.carried[rows], self.slope[rows])

    def foretold(self, move: Tensor) -> Tensor:
        """Where the dynamics should take the states after a move, ``(m, t - 1, k)``."""
        return self.carried + (self.slope @ move[:, :-1, :, None]).squeeze(-1)


@dataclass(frozen=True)
class _Misses:
    """What is wrong with some states: of the dynamics, of the positions, and in all.

    Args:
        defect: over its deviation, ``(m, t - 1, k)``.
        residual: over the expected error, ``(m, t, n, d)``.
        cost: ``(m,)``.
    """

    defect: Tensor
    residual: Tensor
    cost: Tensor

    def __getitem__(self, rows: Tensor) -> _Misses:
        return _Misses(self.defect[rows], self.residual[rows], self.cost[rows])


@dataclass(frozen=True)
class _Problem:
    """The fit as a function of the flat states of all frames, ``(m, t, k)``: positions first."""

    step: Step
    positions: Tensor
    error: Tensor
    interval: float
    precision: torch.dtype
    settings: SmoothingSettings

    def path(self, x: Tensor) -> _Path:
        rows = torch.arange(len(x), device=x.device)
        carried = self.carried(x, rows)
        frames = len(rows), x.shape[1] - 1
        each = rows.repeat_interleave(frames[1])
        slope = self.slopes(x[:, :-1].flatten(0, 1), carried.flatten(0, 1), each)
        return _Path(x, carried, slope.unflatten(0, frames))

    def states(self, x: Tensor) -> PhaseState:
        n, d = self.positions.shape[2:]
        q, p = x.unflatten(-1, (2, n, d)).unbind(-3)
        return PhaseState(q, p)

    def stepped(self, x: Tensor, rows: Tensor) -> Tensor:
        """States ``(..., m, k)`` a frame later."""
        later = self.step(self.states(x.to(self.precision)), rows)
        return torch.stack([later.q, later.p], -3).flatten(-3).to(x)

    def carried(self, x: Tensor, rows: Int[Tensor, " m"]) -> Tensor:
        """Where the dynamics take all states but the last, ``(m, t - 1, k)``."""
        return self.stepped(x[:, :-1].transpose(0, 1), rows).transpose(0, 1)

    def slopes(self, x: Tensor, carried: Tensor, rows: Int[Tensor, " r"]) -> Tensor:
        """How single states ``(r, k)`` carry on, by differences, ``(r, k, k)``."""
        nudge = torch.finfo(self.precision).eps ** 0.5
        moved = x + nudge * torch.eye(x.shape[-1]).to(x)[:, None]
        return ((self.stepped(moved, rows) - carried) / nudge).movedim(0, -1)

    def deviation(self, slack: float) -> Tensor:
        """Of a state's numbers from where the dynamics take it, ``(k,)``."""
        half = self.positions.shape[2] * self.positions.shape[3]
        momentum = self.positions.new_full((half,), slack)
        return torch.cat([momentum * self.interval, momentum])

    def misses(self, x: Tensor, carried: Tensor, rows: Int[Tensor, " m"], slack: float) -> _Misses:
        defect = (x[:, 1:] - carried) / self.deviation(slack)
        residual = (self.states(x).q - self.positions[rows]) / self.error[rows, ..., None]
        square = self.settings.outlying**2
        unlikely = square * (residual.square().sum(-1) / square).log1p()
        cost = defect.square().flatten(1).sum(1) + unlikely.flatten(1).sum(1)
        cost = torch.where(torch.isfinite(cost), cost, torch.inf)
        return _Misses(defect, residual, cost)

    def normal(
        self, slope: Tensor, rows: Tensor, slack: float, missed: _Misses
    ) -> tuple[Tensor, Tensor]:
        """Normal matrix ``(m, t k, t k)`` and half of the gradient ``(m, t k)``."""
        m, before_last, k = missed.defect.shape
        t, deviation = before_last + 1, self.deviation(slack)
        slope = slope / deviation[:, None]
        far = missed.residual.square().sum(-1, keepdim=True) / self.settings.outlying**2
        trust = 1 / (1 + far)
        pull = trust / self.error[rows, ..., None]
        weight = (pull / self.error[rows, ..., None]).expand_as(missed.residual).flatten(2)
        nothing = torch.zeros_like(weight)
        matrix, frame = slope.new_zeros(m, t, t, k, k), torch.arange(t, device=slope.device)
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


def _minimise(problem: _Problem, path: _Path, slack: float) -> Tensor:
    """Levenberg-Marquardt on a path, in place, each episode with its own damping and its own end.

    Returns:
        The cost of each episode.
    """
    settled = problem.settings.settled
    rows, deviation = torch.arange(len(path.x), device=path.x.device), problem.deviation(slack)
    damping = torch.full_like(path.x[:, 0, 0], 1e-3)
    missed = problem.misses(path.x, path.carried, rows, slack)
    cost = missed.cost.clone()
    matrix, gradient = problem.normal(path.slope, rows, slack, missed)
    for _ in range(problem.settings.rounds):
        usable = torch.isfinite(matrix).flatten(1).all(1) & torch.isfinite(gradient).all(1)
        usable &= torch.isfinite(cost[rows])
        rows, matrix, gradient = rows[usable], matrix[usable], gradient[usable]
        if not len(rows):
            break
        ridge = damping[rows, None] * matrix.diagonal(dim1=1, dim2=2)
        move = -torch.linalg.solve(matrix + torch.diag_embed(ridge), gradient)
        move = move.unflatten(1, path.x.shape[1:])
        trial = path.x[rows] + move
        carried = problem.carried(trial, rows)
        missed = problem.misses(trial, carried, rows, slack)
        gained = missed.cost < cost[rows]
        slight = gained & (cost[rows] - missed.cost < settled * missed.cost)
        apart = (carried - path[rows].foretold(move)).abs()
        off = (apart > problem.settings.foretold * deviation).any(-1)
        some, frame = torch.nonzero(off & gained[:, None], as_tuple=True)
        path.x[rows[gained]], path.carried[rows[gained]] = trial[gained], carried[gained]
        cost[rows[gained]] = missed.cost[gained]
        if len(some):
            here = trial[some, frame], carried[some, frame], rows[some]
            path.slope[rows[some], frame] = problem.slopes(*here)
        damping[rows] *= torch.where(gained, 0.1, 10.0).to(damping)
        left = ~slight & (damping[rows] < problem.settings.stuck)
        # Where nothing was gained, the states are those that were looked at before.
        moved, again = gained[left], gained & left
        rows, matrix, gradient = rows[left], matrix[left], gradient[left]
        if bool(moved.any()):
            found = problem.normal(path.slope[rows[moved]], rows[moved], slack, missed[again])
            matrix[moved], gradient[moved] = found
    return cost
