"""Benchmark rows of rollouts: compiled pair laws and networks, beside JAX, torch and the truth."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch

from benchmarks import peers
from benchmarks.contenders import DT, WIDTH, episodes, fitted
from benchmarks.match import Contender, Match
from dynamics import HEADS, build, terms
from dynamics.compiled import compile_head
from vidphys.scenes.gravity import SOFTENING

LONG, USUAL, SHORT, FEW = 2000, 150, 40, 8  # steps of fast, of slow and of the slowest contenders
EPISODES, MANY_EPISODES = 64, 1024


def _rolled(head: Any, steps: int, count: int = EPISODES) -> Contender:
    """A rollout of the shared episodes, as a contender."""
    start, params = episodes(count)

    def work() -> Any:
        with torch.no_grad():
            return head.trajectory(start, params, steps, DT)

    return Contender(work, count * steps, work().backend)


def _jax(gradient: str, head: Any, count: int = EPISODES, steps: int = SHORT) -> Contender:
    pair = {"displacement": peers.plane_gradient, "radial": peers.radial_gradient}[gradient]
    start, params = episodes(count)
    work = peers.jax_leapfrog(pair, head.potential.phi, start, params, steps, DT)
    return Contender(work, count * steps, "jax")


def compiled_factored() -> Match:
    """A compiled pair law against its own network in JAX, the gradient written by hand."""
    head = fitted(terms.Displacement(width=WIDTH))
    ours = _rolled(compile_head(head), LONG)
    peer = {"JAX scan, gradient by hand": (_jax("displacement", head), 100.0)}
    return Match("compiled factored", "episode-steps", ours, peer)


def compiled_radial() -> Match:
    """A compiled radial law against the networks in JAX, and against the true law in numba."""
    head = fitted(terms.Radial(width=WIDTH))
    start, params = episodes(EPISODES)
    truth = peers.numba_truth(start, params, LONG, DT, SOFTENING)
    factored = _jax("displacement", fitted(terms.Displacement(width=WIDTH)))
    against = {
        "JAX scan, factored, gradient by hand": (factored, 200.0),
        "JAX scan, its own network, gradient by hand": (_jax("radial", head), 200.0),
        "true gravity in numba": (Contender(truth, EPISODES * LONG, "numba"), 0.8),
    }
    return Match(
        "compiled factored-radial", "episode-steps", _rolled(compile_head(head), LONG), against
    )


def _network_factored(row: str, count: int, steps: int) -> Match:
    """The network itself in the fused loop, against what others write."""
    head = fitted(terms.Displacement(width=WIDTH))
    start, params = episodes(count)
    user = peers.diffrax_rollout(head.potential.phi, start, params, steps, DT)  # type: ignore[attr-defined]
    least = max(1, steps // 8)
    torch_user = peers.torchdiffeq_rollout(head, start, params, least, DT)
    against = {
        "JAX scan, gradient by hand": (_jax("displacement", head, count, steps), 1.0),
        "diffrax, jax.grad": (Contender(user, count * steps, "jax"), 1.3),
        "torchdiffeq, RK4": (Contender(torch_user, count * least, "torch"), 6.0),
    }
    return Match(row, "episode-steps", _rolled(head, steps, count), against)


network_factored = partial(_network_factored, "network factored", EPISODES, SHORT)
network_factored_many = partial(
    _network_factored, "network factored, 1,024 episodes", MANY_EPISODES, FEW
)


def network_unstructured() -> Match:
    """A transition map, which has no gradient, against the same products in JAX."""
    torch.manual_seed(0)
    head: Any = build(HEADS["unstructured"], bodies=3, dt=DT)
    start, params = episodes(EPISODES)
    theirs = Contender(peers.jax_map(head, start, params, USUAL), EPISODES * USUAL, "jax")
    ours = _rolled(head, USUAL)
    return Match("network unstructured", "episode-steps", ours, {"JAX scan": (theirs, 1.0)})
