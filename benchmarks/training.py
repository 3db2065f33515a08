"""Training steps that the benchmark times: ours, plain eager torch, and ten seeds at once."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from benchmarks.contenders import episodes
from dynamics import Hamiltonian, HamiltonianTerms, Head, Parameters, PhaseState, build
from vidphys.training.ensemble import Ensemble, stack
from vidphys.training.learner import FitSettings, Learner, Loss
from vidphys.training.segments import Segments, scale_of, segment_loss

DT, RATE = 0.002, 1e-3
MANY = 10**6  # steps of a training that is never ended


@dataclass(frozen=True)
class Problem:
    """One-step prediction: a model, where bodies start, and their increments after a step."""

    head: Hamiltonian
    start: PhaseState
    params: Parameters
    target: PhaseState

    @property
    def segments(self) -> Segments:
        """The same examples as training takes them."""
        q, p = self.target.q.unsqueeze(1), self.target.p.unsqueeze(1)
        return Segments(self.start, self.params, q, p, DT, 1)


def problem(width: int, batch: int, seed: int = 0) -> Problem:
    """A fresh factored model and ``batch`` examples under gravity."""
    torch.manual_seed(seed)
    head = build(HamiltonianTerms(width=width), bodies=3, dt=DT)
    assert isinstance(head, Hamiltonian)
    start, params = episodes(batch, seed=seed)
    target = PhaseState(DT * start.p, DT * torch.randn_like(start.p))
    return Problem(head, start, params, target)


def our_step(made: Problem) -> Callable[[], Any]:
    """A step of :func:`vidphys.training.loop.fit`: forces written out, one backward, Adam."""
    head, examples = copy.deepcopy(made.head), made.segments
    return _learning(head, segment_loss(head, scale_of(examples)), examples)


def eager_step(made: Problem) -> Callable[[], Any]:
    """The same loss as one writes it first: forces by autograd, through which it goes again."""
    head, start, params = copy.deepcopy(made.head), made.start, made.params
    scale, size = scale_of(made.segments), made.target.p.square().sum(-1, keepdim=True)
    mass = params.mass.unsqueeze(-1)

    def force(q: Tensor) -> Tensor:
        if not q.requires_grad:
            q = q.clone().requires_grad_()
        energy = head.potential.energy(q, params).sum()
        return -torch.autograd.grad(energy, q, create_graph=True)[0]

    def loss() -> Tensor:
        half = start.p + 0.5 * DT * force(start.q)
        q = start.q + DT * half / mass
        p = half + 0.5 * DT * force(q)
        wrong_q = ((q - start.q - made.target.q) / scale.q).square().mean()
        wrong_p = (p - start.p - made.target.p).square() / (size + scale.p_small**2)
        return wrong_q + wrong_p.mean()

    return _stepped(head, loss)


def _learning(module: torch.nn.Module, loss: Loss, examples: Segments) -> Callable[[], Any]:
    learner = Learner(module, loss, FitSettings(MANY, 0, RATE))
    return lambda: learner.update(examples)


def _stepped(module: torch.nn.Module, loss: Callable[[], Tensor]) -> Callable[[], Any]:
    optimiser = torch.optim.Adam(module.parameters(), RATE)

    def step() -> float:
        optimiser.zero_grad()
        value = loss()
        value.backward()
        optimiser.step()
        return float(value.detach())

    return step


def together_and_apart(
    seeds: int, width: int, batch: int
) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """A training step of every seed: as one computation, and one after another."""
    made = [problem(width, batch, seed) for seed in range(seeds)]
    scale, every = scale_of(made[0].segments), stack([one.segments for one in made])
    ensemble: Ensemble[Head] = Ensemble([copy.deepcopy(one.head) for one in made])
    loss = ensemble.loss(lambda head, batch: segment_loss(head, scale)(batch))
    steps = [our_step(one) for one in made]
    return _learning(ensemble, loss, every), lambda: [step() for step in steps]
