"""Benchmark rows on a CUDA card: networks rolled and trained, splats, features.

Every call ends by waiting for the card. Where one takes microseconds, a call is many in a row, as a
program asks for them.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import torch
from torch import Tensor

from benchmarks import peers
from benchmarks.contenders import DT, WIDTH, episodes, fitted, problem
from benchmarks.encoders import FRESH, IMAGE, dinov2_small
from benchmarks.match import Contender, Match
from benchmarks.renderers import FRAMES, PICTURES, Case, Draw
from benchmarks.rollouts import COMPILING, EULER, NETWORK, ODEINT, SPLINE
from benchmarks.training import ADAM, eager_step, our_step
from dynamics import Hamiltonian, PhaseState, terms
from dynamics.compiled import compile_head
from encoders.frozen import DINOv2Encoder, DINOv2Settings
from vidphys.placement import moved

CARD, EPISODES = "cuda", 64
LONG, SOME, FEW = 2000, 200, 20  # steps of fast, of slow and of the slowest contenders
ROW = 50  # batches of pictures, asked for one after another
FLOPS_A_STEP = 3 * 2 * 4 * WIDTH**2  # of an episode: pairs, signs, two products of two operations
FLOPS_A_TRAINING = 2 * 3 * FLOPS_A_STEP  # of an example: two forces, each with its way back
PRODUCT = 8192  # rows and columns of matrices, in float32


def network() -> Match:
    """The network itself in one kernel for all steps, against what others write, 64 episodes."""
    head = fitted(terms.Displacement(width=WIDTH))
    start, params = episodes(EPISODES)
    card = copy.deepcopy(head).to(CARD)
    given = moved((start, params), CARD)
    peer: dict[str, tuple[Contender, float]] = {
        "torch, step by step": (
            _rolled(card.plain_trajectory, given, SOME, "torch", NETWORK),
            10.0,
        ),
        "torch.compile of a step": (_compiled_step(card, given), 1.0),
    }
    phi: Any = head.potential
    work = peers.jax_leapfrog(peers.plane_gradient, phi.phi, start, params, LONG, DT)
    for precision in ("float32", "tensorfloat32"):
        theirs = _with_products(work, precision)
        contender = Contender(theirs, EPISODES * LONG, "jax", NETWORK, COMPILING)
        peer[f"JAX scan, gradient by hand, products in {precision}"] = contender, 1.0
    user = peers.diffrax_rollout(phi.phi, start, params, SOME, DT)
    peer["diffrax, jax.grad"] = Contender(user, EPISODES * SOME, "jax", EULER, COMPILING), 1.0
    for method, (forces, _) in ODEINT.items():
        odeint = _waited(peers.torchdiffeq_rollout(card, *given, FEW, DT, method))
        what = f"{forces} network forces a step by autograd, {method}"
        peer[f"torchdiffeq, {method}"] = Contender(odeint, EPISODES * FEW, "torch", what), 1.0
    ours = _rolled(card.trajectory, given, LONG, "", NETWORK)
    with torch.no_grad():
        exact = head.double().plain_trajectory(
            *moved((start, params), None, torch.float64), SOME, DT
        )
        found = card.trajectory(*given, SOME, DT).states.q.cpu().double()
    numbers = {
        f"largest |dq| from float64 after {SOME} steps": float(
            (found - exact.states.q).abs().max()
        ),
        "FLOPs of an episode-step": float(FLOPS_A_STEP),
    }
    return Match("network on the card", "episode-steps", ours, peer, numbers, wall=True)


def compiled() -> Match:
    """The spline of the same network, against the network, both in one kernel."""
    head = fitted(terms.Displacement(width=WIDTH))
    card, given = copy.deepcopy(head).to(CARD), moved(episodes(EPISODES), CARD)
    fast = compile_head(head).to(CARD)
    ours = _rolled(fast.trajectory, given, LONG, "", SPLINE)
    against = {"the network": (_rolled(card.trajectory, given, LONG, "", NETWORK), 1.0)}
    return Match("spline on the card", "episode-steps", ours, against, wall=True)


def _training(batch: int) -> Match:
    """A training step that was recorded, against the same step by step, JAX, and a large product.

    The product's speed is the most that the card has for the step's operations.
    """
    made = problem(width=WIDTH, batch=batch)
    there = replace(moved(made, CARD), head=copy.deepcopy(made.head).to(CARD))
    ours = _waited(our_step(there))
    against = {
        "eager torch, double backward": (
            Contender(_waited(eager_step(there)), 1, "torch", ADAM),
            1.0,
        ),
        "JAX, gradient by hand": (
            Contender(peers.jax_training(made), 1, "jax", ADAM, COMPILING),
            1.0,
        ),
    }
    flops, x = batch * FLOPS_A_TRAINING, torch.randn(PRODUCT, PRODUCT, device=CARD)
    against["a product of matrices, as many operations"] = (
        Contender(_waited(lambda: x @ x), 2 * PRODUCT**3 / flops, "torch", "float32"),
        0.6,
    )
    row = f"training step on the card, batch {batch:,}"
    return Match(row, "training steps", Contender(ours, 1, "torch", ADAM), against, wall=True)


training = partial(_training, 1024)
training_large = partial(_training, 8192)


def _drawn(kind: str, both: bool) -> Match:
    """Pictures of one kind into memory that is there, against torch.compile and torch."""
    case = moved(Case.drawn(), CARD)
    ours, naive = {
        "gaussians": (case.gaussians, case.naive_gaussians),
        "disks": (case.disks, case.naive_disks),
    }[kind]
    what = PICTURES + (", and the gradient of their places" if both else "")

    def timed(draw: Draw, path: str) -> Contender:
        return Contender(_waited(case.work(draw, both), ROW), ROW * FRAMES, path, what, COMPILING)

    fused = torch.compile(naive, dynamic=False)
    against = {
        "torch.compile": (timed(fused, "torch"), 3.0),
        "torch": (timed(naive, "torch"), 1.0),
    }
    filled = Contender(
        _waited(lambda: case.memory.fill_(0.5), ROW), ROW * FRAMES, "torch", "a fill"
    )
    if not both:
        against["the same bytes set to one number"] = filled, 0.6
    row = f"{kind} {'with backward' if both else 'forward'} on the card"
    return Match(row, "frames", timed(ours, "triton"), against, wall=True)


gaussians = partial(_drawn, "gaussians", both=False)
gaussians_backward = partial(_drawn, "gaussians", both=True)
disks = partial(_drawn, "disks", both=False)
disks_backward = partial(_drawn, "disks", both=True)


def _features(batch: int) -> Match:
    """DINOv2-S in bfloat16, recorded and compiled, against its own network as it is."""
    encoder = dinov2_small(DINOv2Settings(dtype="bfloat16", batch=batch))
    settings = DINOv2Settings(dtype="bfloat16", batch=batch, runtime="compile")
    network: Any = encoder.network.to(CARD)
    fast = DINOv2Encoder(network, settings, "dinov2-small", FRESH)
    pixels = torch.randn(batch, 3, IMAGE, IMAGE, device=CARD, dtype=torch.bfloat16)

    def work(function: Callable[[Tensor], Any]) -> Callable[[], Any]:
        def inferred() -> Any:
            with torch.inference_mode():
                return function(pixels)

        return _waited(inferred)

    what = "features in bfloat16 of pixels that are ready"
    ours = work(lambda x: fast.fast_maps(x, fast.layers[-1:]))
    eager = Contender(work(network.forward_features), batch, "torch", what)
    return Match(
        f"dinov2-small on the card, {batch} frames a pass",
        "frames",
        Contender(ours, batch, "torch.compile, recorded", what, COMPILING),
        {"bfloat16 eager": (eager, 1.5)},
        wall=True,
    )


features = partial(_features, 8)
features_large = partial(_features, 64)


def _rolled(roll: Callable[..., Any], given: Any, steps: int, path: str, what: str) -> Contender:
    @torch.no_grad()
    def work() -> Any:
        return roll(*given, steps, DT)

    found = work()
    return Contender(_waited(work), EPISODES * steps, path or found.backend, what)


def _compiled_step(head: Hamiltonian, given: Any) -> Contender:
    """A step compiled by torch and recorded, in a loop that keeps every state."""
    start, params = given

    @torch.no_grad()
    def work() -> Tensor:
        q, p, force = start.q, start.p, head.potential.force(start.q, params)
        kept = []
        for _ in range(SOME):
            torch.compiler.cudagraph_mark_step_begin()
            q, p, force = (x.clone() for x in step(q, p, force))
            kept.append(q)
        return torch.stack(kept)

    def plain(q: Tensor, p: Tensor, force: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        state, force = head.advance(PhaseState(q, p), params, DT, force)
        return state.q, state.p, force

    step = torch.compile(plain, dynamic=False, mode="reduce-overhead")
    return Contender(_waited(work), EPISODES * SOME, "torch", NETWORK, COMPILING)


def _with_products(work: Callable[[], Any], precision: str) -> Callable[[], Any]:
    """JAX's own default is tensorfloat32, of ten bits."""

    def whole() -> Any:
        with jax.default_matmul_precision(precision):
            return work()

    return whole


def _waited(work: Callable[[], Any], times: int = 1) -> Callable[[], Any]:
    def whole() -> Any:
        for _ in range(times):
            found = work()
        torch.cuda.synchronize()
        return found

    return whole
