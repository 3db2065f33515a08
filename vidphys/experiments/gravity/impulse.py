"""Planning an impulse through a model, to be executed in the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from dynamics import PhaseState

KICKED = 0  # the body that is pushed and has to reach its target
PROBE = 1e-3  # momentum units, of the finite differences
ROUNDS = 4
DAMPINGS = (1e-6, 1e-2, 1.0)  # over the mean square of the Jacobian; the best of them is taken

Rolled = Callable[[PhaseState], Tensor]


@dataclass(frozen=True)
class Plan:
    """An impulse for each episode.

    Args:
        impulse: momentum given to the body at the start, ``(b, d)``.
        error: distance to the target that the model predicts, world units, ``(b,)``.
    """

    impulse: Tensor
    error: Tensor


def kicked(start: PhaseState, impulse: Tensor) -> PhaseState:
    """The start with an impulse given to one body; ``(..., b, n, d)`` and ``(..., b, d)``."""
    push = torch.zeros_like(start.p).expand(*impulse.shape[:-1], *start.p.shape[-2:]).clone()
    push[..., KICKED, :] = impulse
    p = start.p + push
    return PhaseState(start.q.expand_as(p), p)


def plan_impulse(where: Rolled, start: PhaseState, target: Tensor, budget: float) -> Plan:
    """The impulse after which the model says that the body reaches its target.

    Damped Gauss-Newton steps, by finite differences, each episode by itself; an episode keeps the
    best impulse that it met. Impulses longer than the budget are shortened to it.

    Args:
        where: the model: start states ``(b, n, d)`` to the body's final positions ``(b, d)``.
        start: ``(b, n, d)``.
        target: ``(b, d)``, world units.
        budget: largest impulse, momentum units.
    """
    b, d = target.shape
    best = Plan(torch.zeros_like(target), _distance(where(start), target))
    probes = PROBE * torch.eye(d, dtype=target.dtype)
    for _ in range(ROUNDS):
        around = torch.cat([best.impulse[None], best.impulse + probes[:, None]])
        reached = _many(where, start, around)
        jacobian = ((reached[1:] - reached[0]) / PROBE).permute(1, 2, 0)
        miss = (target - reached[0]).unsqueeze(-1)
        normal = jacobian.mT @ jacobian
        size = normal.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None].clamp_min(1e-12)
        eye = torch.eye(d, dtype=target.dtype)
        steps = [
            torch.linalg.solve(normal + damping * size * eye, jacobian.mT @ miss).squeeze(-1)
            for damping in DAMPINGS
        ]
        tried = _within(best.impulse + torch.stack(steps), budget)
        errors = _distance(_many(where, start, tried), target)
        # A model that is lost on the way is as far off as can be.
        errors = torch.where(torch.isfinite(errors), errors, torch.inf)
        error, index = errors.min(0)
        better = error < best.error
        chosen = tried[index, torch.arange(b)]
        best = Plan(
            torch.where(better.unsqueeze(-1), chosen, best.impulse),
            torch.where(better, error, best.error),
        )
    return best


def _many(where: Rolled, start: PhaseState, impulses: Tensor) -> Tensor:
    """Final positions under several impulses an episode, ``(k, b, d)``, as one batch."""
    states = kicked(start, impulses)
    flat = where(states.map(lambda x: x.flatten(0, 1)))
    return flat.unflatten(0, impulses.shape[:2])


def _within(impulse: Tensor, budget: float) -> Tensor:
    size = impulse.norm(dim=-1, keepdim=True).clamp_min(torch.finfo(impulse.dtype).tiny)
    finite = torch.nan_to_num(impulse)
    return finite * (budget / size).nan_to_num().clamp_max(1.0)


def _distance(reached: Tensor, target: Tensor) -> Tensor:
    return (reached - target).norm(dim=-1)
