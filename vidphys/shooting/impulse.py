"""Planning an impulse through a model: which push takes a body where it shall be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from dynamics import PhaseState

PROBE = 1e-3  # momentum units, of the finite differences
ROUNDS = 4
DAMPINGS = (1e-6, 1e-2, 1.0)  # over the mean square of the Jacobian; the best of them is taken

SAMPLES, ELITES, GENERATIONS = 64, 8, 12  # of the cross-entropy search
LEAST_WIDTH = 0.1  # share of its width that a generation keeps at least, so that it can still move

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

    def or_of(self, tried: Tensor, errors: Tensor) -> Plan:
        """The best of this one and of others, ``(k, b, d)`` with errors ``(k, b)``."""
        error, index = errors.min(0)
        better = error < self.error
        chosen = tried[index, torch.arange(len(error))]
        return Plan(
            torch.where(better.unsqueeze(-1), chosen, self.impulse),
            torch.where(better, error, self.error),
        )


def kicked(start: PhaseState, impulse: Tensor, body: int = 0) -> PhaseState:
    """The start with an impulse given to one body; ``(..., b, n, d)`` and ``(..., b, d)``."""
    push = torch.zeros_like(start.p).expand(*impulse.shape[:-1], *start.p.shape[-2:]).clone()
    push[..., body, :] = impulse
    p = start.p + push
    return PhaseState(start.q.expand_as(p), p)


def plan_impulse(
    where: Rolled, start: PhaseState, target: Tensor, budget: float, body: int = 0
) -> Plan:
    """The impulse after which the model says that the body reaches its target.

    Damped Gauss-Newton steps, by finite differences, each episode by itself; an episode keeps the
    best impulse that it met. Impulses longer than the budget are shortened to it.

    Args:
        where: the model: start states ``(b, n, d)`` to the body's final positions ``(b, e)``.
        start: ``(b, n, d)``.
        target: ``(b, e)``, in the unit of the positions.
        budget: largest impulse, momentum units.
        body: that is pushed.
    """
    best = _none(where, start, target)
    b, d = best.impulse.shape
    probes = PROBE * torch.eye(d, dtype=target.dtype)
    for _ in range(ROUNDS):
        around = torch.cat([best.impulse[None], best.impulse + probes[:, None]])
        reached = _many(where, start, around, body)
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
        best = best.or_of(tried, _missed(where, start, tried, target, body))
    return best


def search_impulse(
    where: Rolled, start: PhaseState, target: Tensor, budget: float, body: int = 0, seed: int = 0
) -> Plan:
    """The same by the cross-entropy method: of many pushes the nearest say where to look next.

    It needs no slope, so it also finds a push where the slope at rest leads astray; it asks the
    model more often (see Rubinstein and Kroese, The cross-entropy method, 2004).

    Args:
        where, start, target, budget, body: as of :func:`plan_impulse`.
        seed: of the pushes that are tried.
    """
    best = _none(where, start, target)
    rng = Generator().manual_seed(seed)
    middle, width = best.impulse, torch.full_like(best.impulse, budget / 2)
    for _ in range(GENERATIONS):
        noise = torch.randn(SAMPLES, *middle.shape, generator=rng, dtype=middle.dtype)
        tried = _within(middle + width * noise, budget)
        errors = _missed(where, start, tried, target, body)
        best = best.or_of(tried, errors)
        nearest = errors.argsort(0)[:ELITES].unsqueeze(-1).expand(-1, -1, middle.shape[-1])
        elite = tried.gather(0, nearest)
        middle, width = elite.mean(0), elite.std(0).clamp_min(LEAST_WIDTH * width)
    return best


def _none(where: Rolled, start: PhaseState, target: Tensor) -> Plan:
    """No push at all."""
    impulse = torch.zeros(len(target), start.p.shape[-1], dtype=target.dtype)
    return Plan(impulse, _distance(where(start), target))


def _missed(where: Rolled, start: PhaseState, tried: Tensor, target: Tensor, body: int) -> Tensor:
    """Distances to the target ``(k, b)``; a model that is lost on the way is infinitely far off."""
    errors = _distance(_many(where, start, tried, body), target)
    return torch.where(torch.isfinite(errors), errors, torch.inf)


def _many(where: Rolled, start: PhaseState, impulses: Tensor, body: int) -> Tensor:
    """Final positions under several impulses an episode, ``(k, b, e)``, as one batch."""
    states = kicked(start, impulses, body)
    flat = where(states.map(lambda x: x.flatten(0, 1)))
    return flat.unflatten(0, impulses.shape[:2])


def _within(impulse: Tensor, budget: float) -> Tensor:
    size = impulse.norm(dim=-1, keepdim=True).clamp_min(torch.finfo(impulse.dtype).tiny)
    finite = torch.nan_to_num(impulse)
    return finite * (budget / size).nan_to_num().clamp_max(1.0)


def _distance(reached: Tensor, target: Tensor) -> Tensor:
    return (reached - target).norm(dim=-1)
