"""Benchmark rows of training: one step beside JAX and eager torch, ten seeds at once."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks import peers
from benchmarks.benchmark import Contender, Match
from benchmarks.contenders import WIDTH
from benchmarks.training import eager_step, our_step, problem, together_and_apart


def ten_seeds() -> Match:
    """Training steps of ten seeds side by side against one after another, width 64."""
    together, apart = together_and_apart(seeds=10, width=64, batch=1024)
    ours = Contender(together, 10, "torch")
    peer = {"one after another": (Contender(apart, 10, "torch"), 1.5)}
    return Match("ten seeds together", "training steps", ours, peer)


def training_step() -> Match:
    """One training step of the factored model against JAX and against eager torch."""
    made = problem(width=WIDTH, batch=1024)
    against = {
        "JAX, gradient by hand": (Contender(peers.jax_training(made), 1, "jax"), 1.8),
        "eager torch, double backward": (Contender(eager_step(made), 1, "torch"), 1.3),
    }
    ours = Contender(our_step(made), 1, "torch")
    return Match("training step", "training steps", ours, against)


ROWS: dict[str, Callable[[], Match]] = {
    "training-step": training_step,
    "ten-seeds": ten_seeds,
}
