"""What computes: torch's operations one by one, or a faster way to the same numbers.

Physics is written in torch's operations and knows no other way: a class asks its engine, and the
engines are what stands here, above the physics and the loops.

| what | no gradient is asked | a gradient is, or models are mapped over |
|---|---|---|
| one pair law | :mod:`dynamics.compiled.cpu`, ``cuda`` | :mod:`dynamics.compiled.unrolled_orbits` |
| a residual map | :mod:`dynamics.compiled.maps` | :mod:`dynamics.compiled.unrolled` |
| any other step on a card | :mod:`dynamics.compiled.graphs` | torch |
| rows of a tanh network | :mod:`dynamics.compiled.gradient`, ``network_cuda`` | the same |
| pairs of a law of displacements | :mod:`dynamics.compiled.disk_cuda`, on a card | the same |
| a compiled model | by its backend: torch, ``cpu`` or ``cuda`` | the same, with no way back |

The loops need numba, or Triton: they are imported here alone, when they are first run.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, cast

import torch
from torch import Tensor

from dynamics.compiled.episodes import Episodes, told
from dynamics.compiled.head import PARTS, WIDEST, Backend, CompiledHead, fastest, refusal
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head, Trajectory
from dynamics.integrators import leapfrog
from dynamics.mlp import MLP
from dynamics.potentials import DisplacementPotential, PairPotential
from dynamics.state import Parameters, PhaseState
from dynamics.unstructured import ResidualMap
from loops import has_numba, has_triton

FEWEST_EPISODES = 8  # fewer would leave most of a block of lanes idle
FEWEST_ROWS = 64  # fewer are left to torch
FEWEST_STEPS = 256  # fewer are taken before a recording of one would be made
MOST_BODIES = 8  # with a way back, for which the network's values of every pair and step are kept


def pair_law(
    head: Hamiltonian, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
) -> Trajectory | None:
    """A Hamiltonian whose potential is one learned pair law; see :data:`dynamics.head.Engine`."""
    learned = next(cast(torch.nn.Module, head.potential).parameters(), start.q)
    if len(head.pair_laws()) == 1 and _ways_forward(start.q, learned):
        backend = fastest(start.q.device)
        if refusal(head, backend, start.q) is None:
            return _fused(head, start, params, steps, dt, every, backend)
    elif _ways_back(start.q, learned, FEWEST_EPISODES) and _unrolls(head, start.q):
        return _unrolled(head, start, params, steps, dt, every)
    return recorded_steps(head, start, params, steps, dt, every)


def recorded_steps(
    head: Head, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
) -> Trajectory | None:
    """Any head on a card, a step of which is recorded; see :data:`dynamics.head.Engine`."""
    busy = torch.is_grad_enabled() or torch._C._functorch.peek_interpreter_stack() is not None
    if start.q.device.type != "cuda" or busy or steps < FEWEST_STEPS or not start.q.numel():
        return None
    from dynamics.compiled.graphs import stepped

    try:
        states = stepped(head, start, params, steps, dt, every)
    except RuntimeError:  # a step that asks the card for numbers
        return None
    return None if states is None else Trajectory(states, "cuda graph")


def compiled_model(
    head: CompiledHead, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
) -> Trajectory | None:
    """A compiled model, by its backend or the best at hand; see :data:`dynamics.head.Engine`.

    Raises:
        ValueError: the backend cannot run this model here; why is said.
    """
    name, packed = _ready(head, start.q)
    if name == "torch" or not start.q.numel():
        return None
    found = _fused(head, start, params, steps, dt, every, name, packed)
    return None if found.fallbacks and name == "triton" else found  # its kernel has no network


def residual_map(
    head: ResidualMap, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
) -> Trajectory | None:
    """An unstructured map of positions in open space; see :data:`dynamics.head.Engine`."""
    if head.harmonics is not None:
        return recorded_steps(head, start, params, steps, dt, every)
    forward = _ways_forward(start.q, head.scale) and start.q.device.type == "cpu" and has_numba()
    if not forward and not _ways_back(start.q, head.scale, FEWEST_ROWS):
        return recorded_steps(head, start, params, steps, dt, every)
    head.check_step(dt)
    batch, sizes = start.q.shape[:-2], start.q.shape[-2:]
    rows, known = start.flat.reshape(batch.numel(), -1), params.flat.expand(*batch, -1)
    given = (
        head.network,
        head.scale.repeat_interleave(sizes.numel()),
        rows,
        known.reshape(batch.numel(), -1),
        steps // every,
        every,
    )
    # What is handed out is a view: of episodes that lie innermost in memory, or next to it.
    if forward:
        from dynamics.compiled.maps import roll

        states = roll(*given).permute(2, 0, 1)
    else:
        from dynamics.compiled.unrolled import unrolled

        states = unrolled(*given).transpose(0, 1)
    flat = states.reshape(*batch, steps // every + 1, 2 * sizes.numel())
    return Trajectory(PhaseState.from_flat(flat, *sizes), "numba")


def network_output(network: MLP, rows: Tensor) -> Tensor | None:
    """Many rows of a network, where no way back is needed; see :data:`dynamics.mlp.Engine`."""
    known = _differentiable(rows) and not torch.is_grad_enabled()
    if not known or (weights := _weights(network, rows)) is None:
        return None
    if torch._C._functorch.peek_interpreter_stack() is not None:
        return None
    from dynamics.compiled.gradient import output

    return output(rows, *weights) + network.split()[1].bias


def network_gradient(network: MLP, rows: Tensor) -> Tensor | None:
    """The input gradient of many rows, with a way back; see :data:`dynamics.mlp.Engine`."""
    loops = _gradient_loops(network, rows)
    if loops is None or (weights := _weights(network, rows)) is None:
        return None
    return loops.input_gradient(rows, *weights)


def pair_gradient(law: DisplacementPotential, displacement: Tensor) -> Tensor | None:
    """Of pairs on a card, with a way back; see :data:`dynamics.potentials.Engine`."""
    mapped = torch._C._functorch.peek_interpreter_stack() is not None
    # What all models share has no way back through what is mapped over them.
    shared = mapped and not torch._C._functorch.is_batchedtensor(displacement)
    if shared or not _in_triton(displacement):
        return None
    from dynamics.compiled import disk_cuda

    return disk_cuda.pair_gradient(law.phi.gradient, displacement)


def _gradient_loops(network: MLP, rows: Tensor) -> Any:
    """Where the loops over such rows are; ``None`` where none know them."""
    if _differentiable(rows):
        from dynamics.compiled import gradient

        return gradient
    if _in_triton(rows) and network.split()[1].in_features <= max(WIDEST):
        from dynamics.compiled import network_cuda

        return network_cuda
    return None


def _ways_forward(states: Tensor, like: Tensor) -> bool:
    """Whether a rollout can run in loops that have no way back: no gradient is asked.

    Args:
        states: q of the start, ``(..., n, d)``.
        like: a number of the model's, whose precision the states must have.
    """
    mapped = torch._C._functorch.peek_interpreter_stack() is not None
    plain = not (mapped or torch.is_grad_enabled() or torch.compiler.is_compiling())
    known = states.dtype in (torch.float32, torch.float64) and states.dtype == like.dtype
    enough = states.shape[:-2].numel() >= FEWEST_EPISODES and states.numel() > 0
    return plain and known and enough


def _ways_back(states: Tensor, like: Tensor, fewest: int) -> bool:
    """Whether a rollout of so many episodes can run in loops that have a way back."""
    alike = states.dtype == like.dtype and states.shape[:-2].numel() >= fewest
    return alike and _differentiable(states)


def _differentiable(x: Tensor) -> bool:
    """Whether loops with a way back know it: single, on the CPU, mapped over at most once."""
    return x.device.type == "cpu" and _mapped_once(x) and has_numba()


def _in_triton(x: Tensor) -> bool:
    """Whether loops with a way back know it: rows of two, on a card, mapped over at most once."""
    return x.shape[-1] == 2 and x.numel() > 0 and _on_card(x) and _mapped_once(x)


def _on_card(x: Tensor) -> bool:
    return x.device.type == "cuda" and has_triton()


def _mapped_once(x: Tensor) -> bool:
    """Whether it is in single precision and mapped over at most once, with nothing else done."""
    if x.dtype != torch.float32 or torch.compiler.is_compiling():
        return False
    stack = torch._C._functorch.get_interpreter_stack()
    return stack is None or [each.key().name for each in stack] == ["Vmap"]


def _weights(network: MLP, rows: Tensor) -> tuple[Tensor, ...] | None:
    """What loops are given of a network; ``None`` where they know no such network or rows."""
    if len(rows) < FEWEST_ROWS:
        return None
    hidden, last = network.split()
    if not network.is_two_tanh_layers or last.out_features != 1:
        return None
    low, top = hidden
    return low.weight, low.bias, top.weight, top.bias, last.weight


def _unrolls(head: Hamiltonian, states: Tensor) -> bool:
    """Whether loops with a way back know a model: leapfrog and one law of displacements."""
    law = head.potential
    if not isinstance(law, DisplacementPotential) or law.law.box is not None:
        return False
    bodies = 2 <= states.shape[-2] <= MOST_BODIES
    plain = head.integrator == leapfrog and refusal(head, "numba", states) is None
    return law.phi.is_two_tanh_layers and bodies and plain


def _unrolled(
    head: Hamiltonian, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
) -> Trajectory:
    from dynamics.compiled.unrolled_orbits import unrolled

    law = cast(DisplacementPotential, head.potential)
    batch, sizes = start.q.shape[:-2], start.q.shape[-2:]
    rows, known = start.flat.reshape(batch.numel(), -1), told(law.law, params, batch)
    states = unrolled(law, rows, known, steps // every, every, dt)
    return Trajectory(
        PhaseState.from_flat(states.reshape(*batch, *states.shape[1:]), *sizes), "numba"
    )


def _fused(
    head: Hamiltonian,
    start: PhaseState,
    params: Parameters,
    steps: int,
    dt: float,
    every: int,
    backend: str,
    packed: Any = None,
) -> Trajectory:
    """All steps of a model that the backend can roll; ``packed``: its pair function, if at hand."""
    kernels, potential = kernels_of(backend), cast(PairPotential, head.potential)
    law = kernels.packed(potential, start.q) if packed is None else packed
    episodes = Episodes.of(potential.law, start, params)
    parts, stored = [part * dt for part in PARTS[head.integrator.name]], steps // every
    q, p, asked, reached = kernels.roll(law, potential.law.box, episodes, parts, stored, every)
    if start.q.ndim != 3:
        q, p = (x.reshape(*start.q.shape[:-2], *x.shape[1:]) for x in (q, p))
    return Trajectory(PhaseState(q, p), backend, asked, reached)


def _ready(head: CompiledHead, states: Tensor) -> tuple[Backend, Any]:
    """The backend for such states and the pair function as it takes it, found once."""
    key = head.backend, states.dtype, states.device, states.shape[-2:]
    if known := head.packed.get(key):
        return known
    best = fastest(states.device)
    name = head.backend or ("torch" if refusal(head, best, states) else best)
    if trouble := refusal(head, name, states):
        raise ValueError(f"compiled model: backend '{name}' {trouble}")
    name = "torch" if states.shape[-2] < 2 else name
    packed = None if name == "torch" else kernels_of(name).packed(head.potential, states)
    return head.packed.setdefault(key, (name, packed))


@lru_cache
def kernels_of(backend: str) -> Any:
    """The loops of a backend, ``numba`` or ``triton``."""
    if backend == "numba":
        from dynamics.compiled import cpu

        return cpu
    from dynamics.compiled import cuda

    return cuda


Head.engine = recorded_steps
Hamiltonian.engine, ResidualMap.engine, CompiledHead.engine = pair_law, residual_map, compiled_model
MLP.output_engine, MLP.gradient_engine = network_output, network_gradient
DisplacementPotential.gradient_engine = pair_gradient
