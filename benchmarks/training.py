"""Benchmark rows of training: one step beside JAX and eager torch, ten seeds at once."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from benchmarks.contenders import DT, RATE, WIDTH, Problem, problem
from benchmarks.match import Contender, Match
from dynamics import Head
from vidphys.training.ensemble import Ensemble, stack
from vidphys.training.learner import FitSettings, Learner, Loss
from vidphys.training.segments import Segments, scale_of, segment_loss

COMPILING = "compiling, at the first call"
ADAM = "loss of one leapfrog step, its gradient, Adam's update, float32"
MANY = 10**6  # steps of a training that is never ended


def ten_seeds() -> Match:
    """Training steps of ten seeds side by side against one after another, width 64."""
    together, apart = together_and_apart(seeds=10, width=64, batch=1024)
    ours = Contender(together, 10, "torch", ADAM)
    peer = {"one after another": (Contender(apart, 10, "torch", ADAM), 1.5)}
    return Match("ten seeds together", "training steps", ours, peer)


def training_step() -> Match:
    """One training step of the factored model against JAX and against eager torch."""
    from benchmarks import peers  # which are installed for benchmarks alone

    made = problem(width=WIDTH, batch=1024)
    against = {
        "JAX, gradient by hand": (
            Contender(peers.jax_training(made), 1, "jax", ADAM, COMPILING),
            1.8,
        ),
        "eager torch, double backward": (Contender(eager_step(made), 1, "torch", ADAM), 1.3),
    }
    ours = Contender(our_step(made), 1, "torch", ADAM)
    return Match("training step", "training steps", ours, against)


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
