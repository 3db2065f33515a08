"""What the fast paths are compared with: the same models in JAX, diffrax, torchdiffeq and numba.

Imported by the benchmark alone; the packages come with the extra ``bench``. Every peer computes
what ours computes: the same weights, the same inputs, every step stored, float32.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import torch
import torchdiffeq
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.contenders import DT, RATE, Problem
from dynamics import Hamiltonian, Parameters, PhaseState
from dynamics.compiled.cpu import states
from dynamics.compiled.steps import kick, move_all, store
from dynamics.mlp import MLP
from dynamics.potentials import CORE, REACH, SPREAD, RadialPotential
from dynamics.unstructured import ResidualMap
from loops.kernels import kernel, uncounted
from vidphys.training.segments import scale_of

Array = Any
Numbers = NDArray[Any]
Weights = list[tuple[Array, Array]]
Pair = Callable[[Weights, Array], Array]


def weights_of(network: MLP) -> Weights:
    """Each layer's matrix ``(inputs, outputs)`` and bias as JAX arrays."""
    layers = [[x.detach().numpy() for x in layer.parameters()] for layer in network.layers]
    return [(jnp.asarray(matrix.T), jnp.asarray(bias)) for matrix, bias in layers]


def input_gradient(weights: Weights, x: Array) -> Array:
    """Gradient of a tanh network with one output, by hand: two products a hidden layer."""
    slopes = []
    for matrix, bias in weights[:-1]:
        x = jnp.tanh(x @ matrix + bias)
        slopes.append(1 - x * x)
    gradient = weights[-1][0][:, 0]
    for (matrix, _), slope in zip(weights[-2::-1], slopes[::-1], strict=True):
        gradient = (gradient * slope) @ matrix.T
    return gradient


def output(weights: Weights, x: Array) -> Array:
    """The same network's value."""
    for matrix, bias in weights[:-1]:
        x = jnp.tanh(x @ matrix + bias)
    return (x @ weights[-1][0] + weights[-1][1])[..., 0]


def soft(displacement: Array) -> Array:
    """:func:`dynamics.potentials.soft_length`."""
    return jnp.sqrt((displacement**2).sum(-1, keepdims=True) + CORE**2)


def plane_gradient(weights: Weights, displacement: Array) -> Array:
    """:meth:`dynamics.potentials.DisplacementPotential.pair_gradient`."""
    r = soft(displacement)
    u = displacement / (REACH + r)
    both = input_gradient(weights, SPREAD * jnp.concatenate([u, -u]).reshape(-1, 2))
    there, back = jnp.split(both.reshape(2 * u.shape[0], *u.shape[1:]), 2)
    slope = 0.5 * SPREAD * (there - back)
    along = (u * slope).sum(-1, keepdims=True)
    return slope / (REACH + r) - displacement * along / (r * (REACH + r))


def plane_energy(weights: Weights, displacement: Array) -> Array:
    """:meth:`dynamics.potentials.DisplacementPotential.pair_energy`."""
    u = SPREAD * displacement / (REACH + soft(displacement))
    return 0.5 * (output(weights, u) + output(weights, -u))


def radial_gradient(weights: Weights, displacement: Array) -> Array:
    """:meth:`dynamics.potentials.RadialPotential.pair_gradient`."""
    near, far = RadialPotential.NEAR, RadialPotential.FAR
    r = soft(displacement)
    inputs = SPREAD * (2 * jnp.concatenate([r / (near + r), r / (far + r)], -1) - 1)
    gradient = 2 * SPREAD * input_gradient(weights, inputs.reshape(-1, 2)).reshape(inputs.shape)
    slope = gradient[..., :1] * near / (near + r) ** 2 + gradient[..., 1:] * far / (far + r) ** 2
    return slope * displacement / r


def _system(start: PhaseState, params: Parameters) -> tuple[Array, ...]:
    """q, p, masses, pair strengths and incidence of the pairs, as JAX arrays."""
    bodies = start.q.shape[-2]
    i, j = np.triu_indices(bodies, 1)
    incidence = np.zeros((len(i), bodies), np.float32)
    incidence[range(len(i)), i], incidence[range(len(i)), j] = 1, -1
    product = params.coupling[:, None] * params.mass[:, i] * params.mass[:, j]
    parts = start.q, start.p, params.mass[..., None], product[..., None]
    return (*(jnp.asarray(x.numpy()) for x in parts), jnp.asarray(incidence))


def jax_leapfrog(
    gradient: Pair,
    network: MLP | None,
    start: PhaseState,
    params: Parameters,
    steps: int,
    dt: float,
) -> Callable[[], Array]:
    """``lax.scan`` over leapfrog steps with one force each, the gradient written by hand."""
    weights = [] if network is None else weights_of(network)
    q, p, mass, product, incidence = _system(start, params)

    @jax.jit
    def roll(weights: Weights, q: Array, p: Array) -> Array:
        def force(q: Array) -> Array:
            apart = jnp.einsum("pn,bnd->bpd", incidence, q)
            return -jnp.einsum("pn,bpd->bnd", incidence, product * gradient(weights, apart))

        def step(state: Array, _: None) -> tuple[Array, Array]:
            q, p, pull = state
            half = p + 0.5 * dt * pull
            q = q + dt * half / mass
            pull = force(q)
            p = half + 0.5 * dt * pull
            return (q, p, pull), (q, p)

        return jax.lax.scan(step, (q, p, force(q)), length=steps)[1]

    return lambda: jax.block_until_ready(roll(weights, q, p))


def diffrax_rollout(
    network: MLP, start: PhaseState, params: Parameters, steps: int, dt: float
) -> Callable[[], Array]:
    """What a JAX user writes: an energy, ``jax.grad`` of it, and diffrax's symplectic Euler."""
    weights, (q, p, mass, product, incidence) = weights_of(network), _system(start, params)
    times = dt * np.arange(steps + 1, dtype=np.float32)

    @jax.jit
    def roll(weights: Weights, q: Array, p: Array) -> Array:
        def energy(q: Array) -> Array:
            apart = jnp.einsum("pn,bnd->bpd", incidence, q)
            return (product[..., 0] * plane_energy(weights, apart)).sum()

        terms = (
            diffrax.ODETerm(lambda t, p, args: p / mass),
            diffrax.ODETerm(lambda t, q, args: -jax.grad(energy)(q)),
        )
        solution = diffrax.diffeqsolve(
            terms,
            diffrax.SemiImplicitEuler(),
            0.0,
            float(times[-1]),
            None,
            (q, p),
            saveat=diffrax.SaveAt(steps=True),
            stepsize_controller=diffrax.StepTo(ts=jnp.asarray(times)),
            max_steps=steps,
        )
        return solution.ys

    return lambda: jax.block_until_ready(roll(weights, q, p))


def torchdiffeq_rollout(
    head: Hamiltonian,
    start: PhaseState,
    params: Parameters,
    steps: int,
    dt: float,
    method: str,
) -> Callable[[], Tensor]:
    """What a user of torch writes: H, its gradient by autograd, and ``odeint`` with a method."""

    def field(t: Tensor, x: Tensor) -> Tensor:
        with torch.enable_grad():
            state = x.detach().requires_grad_()
            energy = head.energy(PhaseState(state[0], state[1]), params).sum()
            (slope,) = torch.autograd.grad(energy, state)
        return torch.stack([slope[1], -slope[0]])

    times = dt * torch.arange(steps + 1)

    def roll() -> Tensor:
        with torch.no_grad():
            return torchdiffeq.odeint(field, torch.stack([start.q, start.p]), times, method=method)

    return roll


def jax_map(
    head: ResidualMap, start: PhaseState, params: Parameters, steps: int
) -> Callable[[], Array]:
    """``lax.scan`` over a transition map's steps, one flat product a layer."""
    weights = weights_of(head.network)
    scale = jnp.repeat(jnp.asarray(head.scale.numpy()), start.q[0].numel())
    x, known = jnp.asarray(start.flat.numpy()), jnp.asarray(params.flat.numpy())

    @jax.jit
    def roll(weights: Weights, x: Array) -> Array:
        def step(x: Array, _: None) -> tuple[Array, Array]:
            value = jnp.concatenate([x, known], -1)
            for matrix, bias in weights[:-1]:
                value = jax.nn.silu(value @ matrix + bias)
            x = x + scale * (value @ weights[-1][0] + weights[-1][1])
            return x, x

        return jax.lax.scan(step, x, length=steps)[1]

    return lambda: jax.block_until_ready(roll(weights, x))


LANES = 64


@uncounted
def _attract(
    q: Numbers, i: int, j: int, weight: Numbers, pair: int, softening: Any, force: Numbers
) -> None:
    """Softened gravity between two bodies of ``(bodies, 2, LANES)``."""
    for lane in range(LANES):
        x, y = q[i, 0, lane] - q[j, 0, lane], q[i, 1, lane] - q[j, 1, lane]
        squared = x * x + y * y + softening * softening
        pull = weight[pair, lane] / (squared * np.sqrt(squared))
        force[i, 0, lane] -= pull * x
        force[i, 1, lane] -= pull * y
        force[j, 0, lane] += pull * x
        force[j, 1, lane] += pull * y


@kernel
def _true_steps(
    start: Numbers,
    mobility: Numbers,
    strength: Numbers,
    dt: Any,
    softening: Any,
    out: Numbers,
    begin: int,
) -> None:
    """Leapfrog steps of ``LANES`` episodes; every state is stored, the start first.

    Args:
        start: q and p, ``(2, bodies, 2, LANES)``.
        mobility: 1 / m, ``(bodies, 2, LANES)``.
        strength: G m_i m_j, ``(pairs, LANES)``.
        dt: seconds.
        softening: world units.
        out: ``(stored, 2, bodies, 2, episodes)``.
        begin: the first of these episodes.
    """
    q, p, force = start[0].copy(), start[1].copy(), np.zeros_like(start[0])
    flat_q, flat_p, flat_force = q.reshape(-1), p.reshape(-1), force.reshape(-1)
    loose = mobility.reshape(-1)
    for move in range(out.shape[0]):
        # Before the first step comes one of no length, which finds the first force.
        step = dt if move > 0 else np.float32(0)
        half = step * np.float32(0.5)
        move_all(flat_q, flat_p, flat_force, loose, half, step)
        pair = 0
        for i in range(q.shape[0]):
            for j in range(i + 1, q.shape[0]):
                _attract(q, i, j, strength, pair, softening, force)
                pair += 1
        kick(flat_p, flat_force, half)
        store(q, p, begin, LANES, out, move)


def numba_truth(
    start: PhaseState, params: Parameters, steps: int, dt: float, softening: float
) -> Callable[[], Numbers]:
    """The true law in numba, laid out as the compiled rollouts are; a multiple of ``LANES``."""
    episodes, bodies = params.mass.shape
    i, j = np.triu_indices(bodies, 1)
    product = (params.coupling[:, None] * params.mass[:, i] * params.mass[:, j]).T.numpy()
    mobility = np.repeat((1 / params.mass).T.numpy()[:, None], 2, 1)
    first = torch.stack([start.q, start.p]).permute(0, 2, 3, 1).numpy()

    def roll() -> Numbers:
        out = states((steps + 1, *first.shape), np.float32)
        for begin in range(0, episodes, LANES):
            block = slice(begin, begin + LANES)
            parts = (np.ascontiguousarray(x[..., block]) for x in (first, mobility, product))
            _true_steps(*parts, np.float32(dt), np.float32(softening), out, begin)
        return out

    return roll


def jax_training(made: Problem) -> Callable[[], float]:
    """One-step training in JAX: the force by hand, one ``jax.grad`` of the loss, Adam, jitted."""
    start, target = made.start, made.target
    weights = weights_of(made.head.potential.phi)  # type: ignore[attr-defined]
    q, p, mass, product, incidence = _system(start, made.params)
    to_q, to_p = jnp.asarray(target.q.numpy()), jnp.asarray(target.p.numpy())
    scale = scale_of(made.segments)
    size = (to_p**2).sum(-1, keepdims=True) + scale.p_small**2

    def loss(weights: Weights) -> Array:
        def force(q: Array) -> Array:
            apart = jnp.einsum("pn,bnd->bpd", incidence, q)
            return -jnp.einsum("pn,bpd->bnd", incidence, product * plane_gradient(weights, apart))

        half = p + 0.5 * DT * force(q)
        end = q + DT * half / mass
        change = half + 0.5 * DT * force(end) - p
        wrong = (((end - q - to_q) / scale.q) ** 2).mean()
        return wrong + ((change - to_p) ** 2 / size).mean()

    @jax.jit
    def step(state: Array) -> tuple[Array, Array]:
        weights, first, second, count = state
        value, slope = jax.value_and_grad(loss)(weights)
        count = count + 1
        first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slope)
        second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slope)
        scales = 1 - 0.9**count, 1 - 0.999**count

        def moved(w: Array, m: Array, v: Array) -> Array:
            return w - RATE * (m / scales[0]) / (jnp.sqrt(v / scales[1]) + 1e-8)

        return (jax.tree.map(moved, weights, first, second), first, second, count), value

    none = jax.tree.map(jnp.zeros_like, weights)
    kept = [(weights, none, none, jnp.zeros(()))]

    def run() -> float:
        kept[0], value = step(kept[0])
        return float(value)

    return run
