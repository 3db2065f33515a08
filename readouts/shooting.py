"""The initial state of a window, fitted through the dynamics (multiple-shooting readout).

Differencing coarse frames carries both their noise and the truncation error of the difference.
Asking instead which start state makes the *rollout* pass through all observed positions uses the
whole window and has no truncation error beyond the model's own (inventory 14.4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from dynamics.state import PhaseState

Roll = Callable[[PhaseState, int], PhaseState]

MAX_DAMPING = 1e8


@dataclass(frozen=True)
class ShootingFit:
    """The fitted window.

    Args:
        states: the fitted states at every frame, ``(b, t, n, d)``.
        rmse: root mean squared position residual of each episode, world units, ``(b,)``.
        improved: whether the fit beat the guess it started from, ``(b,)``.
    """

    states: PhaseState
    rmse: Float[Tensor, " b"]
    improved: Bool[Tensor, " b"]


def shoot(
    roll: Roll,
    positions: Float[Tensor, "b t n d"],
    guess: PhaseState,
    rounds: int = 4,
    first_window: int = 5,
    confidence: Float[Tensor, "b t n"] | None = None,
) -> ShootingFit:
    """Fit the state at the first frame by damped Gauss-Newton (Levenberg-Marquardt).

    A long window of a chaotic system has many wrong minima, so the fit starts on the first
    ``first_window`` frames and then takes in the rest.

    Args:
        roll: ``(start (..., b, n, d), frames) -> states (..., b, frames, n, d)``, the start
            included. An episode may depend on its own start only.
        positions: observed positions, world units, NaN-free; float64 for an exact fit, because
            the Jacobian is one of differences.
        guess: states at the first frame, ``(b, n, d)``.
        rounds: Gauss-Newton rounds per window.
        first_window: frames of the first window, at least 3.
        confidence: weight of each observation, 1 where not given.

    Raises:
        ValueError: fewer than three frames, or a position that is not finite.
    """
    frames = positions.shape[1]
    if frames < 3:
        raise ValueError(f"shoot: momentum needs at least 3 frames, got {frames}")
    if not bool(torch.isfinite(positions).all()):
        raise ValueError("shoot: positions must be finite; drop or fill the frames that are not")
    weight = torch.ones_like(positions[..., :1]) if confidence is None else confidence[..., None]
    x = guess.flat
    problem = _Problem(roll, positions, weight.sqrt())
    start_cost = problem.cost(x, frames)
    for window in _windows(first_window, frames):
        x = _levenberg_marquardt(problem, x, window, rounds)
    cost = problem.cost(x, frames)
    worse = ~(cost < start_cost)
    x = torch.where(worse[:, None], guess.flat, x)
    states = roll(PhaseState.from_flat(x, positions.shape[2], positions.shape[3]), frames)
    used = weight.expand_as(positions).flatten(1).sum(1).clamp_min(1e-12)
    rmse = (torch.where(worse, start_cost, cost) / used).sqrt()
    return ShootingFit(states, rmse, ~worse)


def _windows(first: int, frames: int) -> list[int]:
    first = max(3, min(first, frames))
    return [first, frames] if first < frames else [frames]


class _Problem:
    """Residuals of a window and their Jacobian in the unknown start state."""

    def __init__(self, roll: Roll, positions: Tensor, weight: Tensor) -> None:
        self.roll, self.positions, self.weight = roll, positions, weight

    def residual(self, x: Tensor, frames: int) -> Tensor:
        start = PhaseState.from_flat(x, self.positions.shape[2], self.positions.shape[3])
        predicted = self.roll(start, frames).q
        difference = self.weight[:, :frames] * (predicted - self.positions[:, :frames])
        return difference.flatten(-3)

    def cost(self, x: Tensor, frames: int) -> Tensor:
        cost = self.residual(x, frames).square().sum(1)
        return torch.where(torch.isfinite(cost), cost, torch.inf)

    def linearise(self, x: Tensor, frames: int) -> tuple[Tensor, Tensor]:
        """Residual ``(b, r)`` and Jacobian ``(b, r, unknowns)`` by forward differences.

        All moved starts are rolled beside the unmoved one, so that a fused rollout serves.
        """
        step = torch.finfo(x.dtype).eps ** 0.5
        moved = step * torch.eye(x.shape[1], dtype=x.dtype, device=x.device)
        residual = self.residual(torch.cat([x[None], x + moved[:, None]]), frames)
        return residual[0], ((residual[1:] - residual[0]) / step).movedim(0, -1)


def _levenberg_marquardt(problem: _Problem, x: Tensor, frames: int, rounds: int) -> Tensor:
    """Per-episode damping: down by 10 where a step helps, up by 10 where it does not."""
    damping = torch.full_like(x[:, :1], 1e-3, dtype=torch.float64)
    cost = problem.cost(x, frames)
    for _ in range(rounds):
        residual, jacobian = problem.linearise(x, frames)
        good = torch.isfinite(jacobian).flatten(1).all(1) & torch.isfinite(cost)
        jacobian = torch.where(good[:, None, None], jacobian, 0)
        residual = torch.where(good[:, None], residual, 0)
        normal = jacobian.mT @ jacobian
        normal, slope = normal.double(), -(jacobian.mT @ residual[..., None]).double()
        ridge = damping * normal.diagonal(dim1=1, dim2=2).clamp_min(1e-12)
        step = torch.linalg.solve(normal + torch.diag_embed(ridge), slope)
        trial = x + step.squeeze(-1).to(x.dtype)
        trial_cost = problem.cost(trial, frames)
        better = trial_cost < cost
        x = torch.where(better[:, None], trial, x)
        cost = torch.where(better, trial_cost, cost)
        damping = torch.where(better[:, None], damping / 10, damping * 10).clamp(max=MAX_DAMPING)
    return x
