"""What the methods promise: order, way back, momentum, oddness, one seed, gradients (A1-A7 ...)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product

import torch
from torch import Tensor

from dynamics import (
    HEADS,
    INTEGRATORS,
    Hamiltonian,
    Head,
    Parameters,
    PhaseState,
    VectorField,
    build,
    rollout,
    tao_gate,
)
from dynamics.bath import ExactBath
from dynamics.friction import Friction
from dynamics.integrators import TAO_GATE
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import DisplacementPotential, RadialPotential, SoftenedGravity
from readouts.soft_argmax import soft_argmax
from renderers import Camera, disks, gaussians
from vidphys.metrics import energy_drift
from vidphys.stress.bodies import DTYPES, STEP, angular_momentum
from vidphys.stress.case import SOUND, Case, Skip

ORDERS = {  # method -> (figure, allowed distance from the declared order, steps that are compared)
    "leapfrog": ("A1", 0.05, (100, 200, 400)),
    "leapfrog_compensated": ("A1", 0.05, (100, 200, 400)),
    "yoshida4": ("A2", 0.15, (100, 200, 400)),
    "kahan_li8": ("A2", 0.15, (8, 12, 16)),
    "rk4": ("A3", 0.1, (100, 200, 400)),
    "implicit_midpoint": ("A3", 0.1, (100, 200, 400)),
    "tao": ("A3", 0.1, (200, 400, 800)),
}


def methods() -> Iterator[Case]:
    """A1 to A7, A23 to A26."""
    cell = partial(Case, value=1.0, integrator="leapfrog", must=(SOUND,))
    for name, (figure, bound, counts) in ORDERS.items():
        order = partial(cell, "method: order", "pendulum", name, bound=bound, figure=figure)
        yield order(run=partial(_order, name, counts), integrator=name)
    three = partial(cell, system="three bodies", extreme="2000 steps")
    for dtype, bound in (("float64", 1e-11), ("float32", 1e-3)):
        run = partial(_retraced, dtype)
        yield three("method: retrace", run=run, bound=bound, figure="A4", dtype=dtype)
    yield three("method: momentum", run=_momentum, bound=1e-12, figure="A5")
    gate = partial(cell, "method: gate", "known Hamiltonian", "0.002 s", figure="A6")
    yield gate(run=lambda: tao_gate(STEP), bound=TAO_GATE, integrator="tao")
    exact = partial(cell, bound=0.0)
    for name, dtype in product(("exact", "factored", "factored-radial"), DTYPES):
        run = partial(_odd, name, dtype)
        yield exact("method: oddness", name, "G and -G", run=run, figure="A7", dtype=dtype)
    yield exact("method: energy zero", "episodes", "E0 = 0", run=_energy_zero, figure="A23")
    path = partial(cell, "method: path", bound=1e-5, figure="A24", dtype="float32")
    for name in ("exact", "factored", "gns", "unstructured"):
        run = partial(_compiled_differs, name)
        yield path(name, "traced against eager", run=run, path="traced")
        yield path(name, "CUDA against CPU", run=partial(_device_differs, name), path="cuda")
    for name in (*HEADS.ours(), "bath"):
        run = partial(_twice, name)
        yield exact("method: determinism", name, "one seed twice", run=run, figure="A25")
    for name, (function, inputs) in differentiable().items():
        run = partial(_gradcheck, function, inputs)
        yield exact("method: gradients", name, "first and second", run=run, figure="A26")


PENDULUM = VectorField(velocity=lambda q, p: p, force=lambda q, p: -q.sin())


def _order(name: str, counts: tuple[int, ...]) -> float:
    """Distance of the measured order from the declared one, on a pendulum over two seconds."""
    method, start = INTEGRATORS[name], torch.tensor([[1.5]], dtype=torch.float64)

    def end(steps: int, integrator: str) -> Tensor:
        state, memory = PhaseState(start, torch.zeros_like(start)), None
        for _ in range(steps):
            stepped = INTEGRATORS[integrator].advance(PENDULUM, state, 2.0 / steps, memory)
            state, memory = stepped
        return state.flat

    exact = end(400, "kahan_li8")
    errors = torch.stack([(end(n, name) - exact).abs().max() for n in counts]).log()
    steps = torch.tensor([2.0 / n for n in counts], dtype=torch.float64).log()
    centred = steps - steps.mean()
    return abs(float((errors * centred).sum() / centred.square().sum()) - method.order)


def three_bodies(dtype: str) -> tuple[Hamiltonian, PhaseState, Parameters]:
    """The study's system with close passages, softening 0.1."""
    q = torch.tensor([[1.0, 0.1], [-0.6, 0.8], [-0.3, -0.9]], dtype=DTYPES[dtype])
    p = torch.tensor([[0.1, 0.5], [-0.4, -0.3], [0.3, -0.2]], dtype=DTYPES[dtype])
    params = Parameters(torch.tensor(1.0), torch.tensor([1.2, 0.8, 1.0])).map(lambda x: x.to(q))
    return Hamiltonian(FixedKinetic(), SoftenedGravity(0.1)), PhaseState(q, p), params


def _retraced(dtype: str) -> float:
    head, start, params = three_bodies(dtype)
    there = rollout(head, start, params, 2000, STEP, 2000).at(-1)
    back = rollout(head, there.reversed, params, 2000, STEP, 2000).at(-1).reversed
    return float((back.flat - start.flat).abs().max())


def _momentum() -> float:
    head, start, params = three_bodies("float64")
    states = rollout(head, start, params, 2000, STEP, 20).states
    turning, total = angular_momentum(states), states.p.sum(-2)
    return float(
        torch.stack([(turning - turning[0]).abs().max(), (total - total[0]).abs().max()]).max()
    )


def _head(name: str, dtype: torch.dtype) -> Head:
    torch.manual_seed(0)
    if name == "exact":
        return three_bodies("float64")[0]
    head = build(HEADS[name], 3, STEP)
    head.set_scale(1e-3, 1e-3)
    return head.to(dtype)


def _odd(name: str, dtype: str) -> float:
    """How many bits' worth of numbers differ between F(-G) and -F(G)."""
    _, state, params = three_bodies(dtype)
    head = _head(name, DTYPES[dtype])
    with torch.no_grad():
        forward = head.force(state, params)
        flipped = head.force(state, params.with_coupling(-1.0))
    return float((forward != -flipped).sum())


def _energy_zero() -> float:
    """How many drifts of an energy that starts at zero are not finite."""
    energy = torch.tensor([[0.0, 1e-9, -1e-3], [1e-300, 1e-9, 0.5]], dtype=torch.float64)
    return float((~torch.isfinite(energy_drift(energy, torch.ones(2).double()))).sum())


def _forces(name: str, device: str = "cpu") -> Tensor:
    _, state, params = three_bodies("float32")
    head = _head(name, torch.float32).to(device)
    state, params = state.map(lambda x: x.to(device)), params.map(lambda x: x.to(device))
    with torch.no_grad():
        return head.force(state, params).cpu()


def _compiled_differs(name: str) -> float:
    """Largest relative difference of the forces of the graph that torch.compile captures."""
    _, state, params = three_bodies("float32")
    head = _head(name, torch.float32)
    traced = torch.compile(lambda s, c: head.force(s, c), backend="aot_eager")
    with torch.no_grad():
        found = traced(state, params)
    exact = _forces(name)
    return float((found - exact).abs().max() / exact.abs().max())


def _device_differs(name: str) -> float:
    if not torch.cuda.is_available():
        raise Skip("this machine has no CUDA device")
    exact = _forces(name)
    return float((_forces(name, "cuda") - exact).abs().max() / exact.abs().max())


def _twice(name: str) -> float:
    """How many numbers differ between two rollouts of one seed."""
    _, state, params = three_bodies("float32")
    if name == "bath":
        params = params.with_scalar("friction", 1.0).with_scalar("temperature", 1.0)
        head: Head = Hamiltonian(FixedKinetic(), SoftenedGravity(0.1), ports=[ExactBath()])
    runs = []
    for _ in range(2):
        model = head if name == "bath" else _head(name, torch.float32)
        runs.append(rollout(model, state, params, 20, STEP, seed=7).states.flat)
    return float((runs[0] != runs[1]).sum())


def differentiable() -> dict[str, tuple[Callable[..., Tensor], tuple[Tensor, ...]]]:
    """Functions of float64 tensors whose gradients are checked, by name, with their inputs."""
    torch.manual_seed(0)
    _, state, params = three_bodies("float64")
    q = state.q.clone().requires_grad_()
    camera = Camera(4.0, 5, 7)
    told = params.with_scalar("friction", 0.7)
    friction = Friction("square", "known")
    logits = torch.randn(3, 4, dtype=torch.float64, requires_grad=True)
    centres = torch.rand(3, 4, 2, dtype=torch.float64)
    networks = {
        "displacement network": DisplacementPotential(2, 8, "tanh").double(),
        "radial network": RadialPotential(8, "softplus").double(),
        "gravity": SoftenedGravity(0.1),
    }
    return {
        **{
            f"{name}, energy": (lambda x, v=v: v.energy(x, params), (q,))
            for name, v in networks.items()
        },
        **{
            f"{name}, force": (lambda x, v=v: v.force(x, params), (q,))
            for name, v in networks.items()
        },
        "gaussians": (lambda x: gaussians(x, camera, 0.5), (q,)),
        "disks": (lambda x: disks(x, camera, 0.6, 0.2), (q,)),
        "square friction": (
            lambda p: friction.kick(PhaseState(q.detach(), p), told, 0.1),
            (state.p.clone().requires_grad_(),),
        ),
        "soft-argmax": (lambda x: soft_argmax(x, centres)[0], (logits,)),
    }


def _gradcheck(function: Callable[..., Tensor], inputs: tuple[Tensor, ...]) -> float:
    """0 if first and second derivatives agree with differences at torch's own tolerances."""
    first = torch.autograd.gradcheck(function, inputs, raise_exception=False)
    second = torch.autograd.gradgradcheck(function, inputs, raise_exception=False)
    return 0.0 if first and second else math.inf
