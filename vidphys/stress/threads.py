"""Threads: what several compute together is what one computes alone, rollouts and gradients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product

import torch
from torch import Tensor

from dynamics import Head, Parameters, PhaseState
from dynamics.head import stepped
from loops.threads import held_to
from vidphys.stress.bodies import STEP
from vidphys.stress.case import SOUND, Case
from vidphys.stress.learned import FAMILIES, trained

COUNTS = (2, 8)
EPISODES, STEPS = 1024, 4
TIMES = 3  # what two threads do to each other need not show at once
ROUNDING = 1e-3  # of the largest change in a step: positions are rounded, sums have another order

Way = Callable[[Head, PhaseState, Parameters], Tensor]


def threads() -> Iterator[Case]:
    """Each family of heads in each way of computing, by some threads."""
    cell = partial(Case, "threads", integrator="own", dtype="float32", must=(SOUND,))
    for name, way, count in product(FAMILIES, WAYS, COUNTS):
        run = partial(_apart, name, way, count)
        yield cell(name, f"{count} threads", count, run, ROUNDING, path=way)


def _apart(name: str, way: str, count: int) -> float:
    """Largest difference from what one thread gives, over the largest number."""
    head, start, params = trained(name, EPISODES)
    head.requires_grad_(way == "gradient")  # what keeps nothing for a way back has other memory
    with held_to(1):
        alone = WAYS[way](head, start, params)
    with held_to(count):
        together = torch.stack([WAYS[way](head, start, params) for _ in range(TIMES)])
    return float((together - alone).abs().max() / alone.abs().max())


def _rolled(head: Head, start: PhaseState, params: Parameters) -> Tensor:
    """How far the states move, by the rollout's own loops."""
    with torch.no_grad():
        return head.trajectory(start, params, STEPS, STEP).states.flat.diff(dim=-2)


def _one_by_one(head: Head, start: PhaseState, params: Parameters) -> Tensor:
    """The same by single steps."""
    with torch.no_grad():
        return stepped(head.advance, start, params, STEPS, STEP, 1).flat.diff(dim=-2)


def _gradients(head: Head, start: PhaseState, params: Parameters) -> Tensor:
    """Of the force's square with respect to all that is learned."""
    force = head.force(start, params)
    learned = list(head.parameters())
    found = torch.autograd.grad(force.square().sum(), learned, materialize_grads=True)
    return torch.cat([x.flatten() / x.abs().max().clamp_min(1e-30) for x in found])


WAYS: dict[str, Way] = {"rollout": _rolled, "steps": _one_by_one, "gradient": _gradients}
