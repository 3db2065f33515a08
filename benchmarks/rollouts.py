"""Benchmark rows of rollouts: compiled pair laws and networks, beside JAX, torch and the truth."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import torch

from benchmarks import peers, splines
from benchmarks.contenders import DT, WIDTH, episodes, fitted
from benchmarks.match import BUILDING, Contender, Match
from dynamics import HEADS, build, terms
from dynamics.compiled import compile_head
from vidphys.scenes.gravity import SOFTENING

LONG, USUAL, SHORT, FEW = 2000, 150, 40, 8  # steps of fast, of slow and of the slowest contenders
EPISODES, MANY_EPISODES = 64, 1024
LADDER = 64  # width of the networks of the ladder's heads
REACH, KNOTS = 1000.0, 2048  # of the spline in JAX: as far as ours, and about as exact
NETWORK = "one network force a step, leapfrog, every state stored, float32"
SPLINE = "one spline force a step in place of the network, leapfrog, every state stored, float32"
FORMULA = "one force by the true formula a step, leapfrog, every state stored, float32"
EULER = "one network force a step by autograd, symplectic Euler (first order), float32"
COMPILING = "compiling, at the first call"
# of torchdiffeq: forces a step, and the least ratio; midpoint is of leapfrog's order
ODEINT = {"rk4": (4, 6.0), "midpoint": (2, 1.0)}


def _rolled(head: Any, steps: int, count: int = EPISODES) -> Contender:
    """A rollout of the shared episodes, as a contender."""
    start, params = episodes(count)
    report = getattr(head, "report", None)
    what, excludes = NETWORK, "nothing"
    if report is not None:
        what, excludes = SPLINE, "building the spline, from the network"

    def work() -> Any:
        with torch.no_grad():
            return head.trajectory(start, params, steps, DT)

    return Contender(work, count * steps, work().backend, what, excludes)


def _jax(gradient: str, head: Any, count: int = EPISODES, steps: int = SHORT) -> Contender:
    pair = {"displacement": peers.plane_gradient, "radial": peers.radial_gradient}[gradient]
    start, params = episodes(count)
    work = peers.jax_leapfrog(pair, head.potential.phi, start, params, steps, DT)
    return Contender(work, count * steps, "jax", NETWORK, COMPILING)


def _compiled(head: Any) -> tuple[Contender, dict[str, float]]:
    """A rollout of the spline of a model; how long it takes to build, and how far it errs."""
    start, params = episodes(EPISODES)
    for _ in range(2):  # the first fills the cache of compiled loops
        began = time.process_time()
        fast = compile_head(head)
        fast.trajectory(start, params, 1, DT)
        built = time.process_time() - began
    assert fast.report is not None
    numbers = {BUILDING: built, "force error": fast.report.error}
    with torch.no_grad():
        q = [x.trajectory(start, params, USUAL, DT).states.q for x in (fast, head)]
    numbers[f"largest |dq| from the network after {USUAL} steps"] = float((q[0] - q[1]).abs().max())
    return _rolled(fast, LONG), numbers


def _compiled_factored(row: str, width: int, bar: float) -> Match:
    """A compiled pair law against its own network, in JAX and in our fused loop."""
    head = fitted(terms.Displacement(width=width))
    ours, numbers = _compiled(head)
    against = {
        "JAX scan, gradient by hand": (_jax("displacement", head), bar),
        "our own network": (_rolled(head, SHORT), 1.0),
    }
    return Match(row, "episode-steps", ours, against, numbers, "our own network")


compiled_factored = partial(_compiled_factored, "compiled factored", WIDTH, 100.0)
compiled_ladder = partial(_compiled_factored, "compiled factored, the ladder's", LADDER, 10.0)


def compiled_radial() -> Match:
    """A compiled radial law against the networks in JAX, and against the true law in numba."""
    head = fitted(terms.Radial(width=WIDTH))
    start, params = episodes(EPISODES)
    truth = peers.numba_truth(start, params, LONG, DT, SOFTENING)
    ours, numbers = _compiled(head)
    spline = splines.splined(head.potential, REACH, KNOTS)  # type: ignore[arg-type]
    same = peers.jax_leapfrog(spline, None, start, params, LONG, DT)
    numbers["force error of the spline in JAX"] = splines.force_error(head.potential, spline)  # type: ignore[arg-type]
    what = "one cubic of log r a step in place of the network, leapfrog, every state stored"
    against = {
        "JAX scan, a spline too": (
            Contender(same, EPISODES * LONG, "jax", what, f"{COMPILING}; building the spline"),
            1.0,
        ),
        "JAX scan, its own network, gradient by hand": (_jax("radial", head), 200.0),
        "true gravity in numba": (Contender(truth, EPISODES * LONG, "numba", FORMULA), 0.8),
    }
    return Match("compiled factored-radial", "episode-steps", ours, against, numbers)


def _network_factored(row: str, count: int, steps: int) -> Match:
    """The network itself in the fused loop, against what others write."""
    head = fitted(terms.Displacement(width=WIDTH))
    start, params = episodes(count)
    user = peers.diffrax_rollout(head.potential.phi, start, params, steps, DT)  # type: ignore[attr-defined]
    least = max(1, steps // 8)
    against = {
        "JAX scan, gradient by hand": (_jax("displacement", head, count, steps), 1.0),
        "diffrax, jax.grad": (Contender(user, count * steps, "jax", EULER, COMPILING), 1.3),
    }
    for method, (forces, bar) in ODEINT.items():
        work = peers.torchdiffeq_rollout(head, start, params, least, DT, method)
        what = f"{forces} network forces a step by autograd, {method}"
        against[f"torchdiffeq, {method}"] = Contender(work, count * least, "torch", what), bar
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
    jax = peers.jax_map(head, start, params, USUAL)
    theirs = Contender(jax, EPISODES * USUAL, "jax", "the map's products a step", COMPILING)
    ours = _rolled(head, USUAL)
    return Match("network unstructured", "episode-steps", ours, {"JAX scan": (theirs, 1.0)})
