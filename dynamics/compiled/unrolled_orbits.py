"""A learned pair law's rollout that can be differentiated, in fused loops; torch's own is the twin.

It is what trains a law of displacements on a CPU: all steps of a block of episodes in one call, and
the way back through them in another. See :mod:`dynamics.compiled.orbits`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function

from dynamics.compiled.gradient import in_torchs_form
from dynamics.compiled.lanes import Array
from dynamics.compiled.memory import Kept
from dynamics.compiled.orbits import LANES, Law, Trace, backward_blocks, forward_blocks
from dynamics.compiled.panels import PANEL, ROWS, in_tiles
from dynamics.compiled.rows import Layers, layers
from dynamics.compiled.shares import Some, by_twin, of_models, on_weights, shares
from dynamics.compiled.twin import plain_gradient
from dynamics.pairs import pair_indices
from dynamics.potentials import REACH, SPREAD, DisplacementPotential, soft_length, unsquashed
from loops.threads import in_threads

Lengths = tuple[int, int, float]


def unrolled(
    potential: DisplacementPotential,
    start: Tensor,
    told: Tensor,
    stored: int,
    every: int,
    dt: float,
) -> Tensor:
    """Leapfrog steps of bodies in a plane under |p|^2 / 2m and a law of displacements.

    Args:
        potential: in open space, of two hidden tanh layers of one width.
        start: q and p, ``(episodes, 2 * bodies * 2)``.
        told: 1 / m of the bodies and c(G) s_i s_j of the pairs, ``(episodes, bodies + pairs)``.
        stored: states that are stored after the start.
        every: steps between them.
        dt: seconds of a step.

    Returns:
        States, ``(episodes, stored + 1, 2 * bodies * 2)``.
    """
    weights = [x for layer in potential.phi.layers for x in layer.parameters()][:-1]
    return of_models(_Unrolled, (stored, every, dt), start, told, *weights)


def plainly(lengths: Lengths, start: Tensor, told: Tensor, *weights: Tensor) -> Tensor:
    """The same by torch's own operations, of models along a first axis; see :class:`_Unrolled`."""
    stored, every, dt = lengths
    bodies = start.shape[-1] // 4
    i, j = pair_indices(bodies, start.device)
    mobility, product = told[..., :bodies, None], told[..., bodies:, None]
    q, p = start.unflatten(-1, (2, bodies, 2)).unbind(-3)

    def force(q: Tensor) -> Tensor:
        apart = q.index_select(-2, i) - q.index_select(-2, j)
        r = soft_length(apart)
        seen = (SPREAD * apart / (REACH + r)).flatten(1, 2)
        both = plain_gradient(seen, *weights) - plain_gradient(-seen, *weights)
        pull = product * unsquashed(0.5 * SPREAD * both.reshape(apart.shape), apart, r)
        return torch.zeros_like(q).index_add(-2, i, pull, alpha=-1).index_add(-2, j, pull)

    states, pulled = [start], force(q)
    for step in range(stored * every):
        half = p + 0.5 * dt * pulled
        q = q + dt * mobility * half
        pulled = force(q)
        p = half + 0.5 * dt * pulled
        if (step + 1) % every == 0:
            states.append(torch.cat([q.flatten(-2), p.flatten(-2)], -1))
    return torch.stack(states, -2)


class _Unrolled(Function):
    """Of models along a first axis: ``(models, episodes, ...)``, and likewise the weights."""

    @staticmethod
    def forward(
        ctx: Any, lengths: Lengths, start: Tensor, told: Tensor, *weights: Tensor
    ) -> Tensor:
        stored, every, dt = lengths
        parts = [w.detach().numpy() for w in weights]
        nets = [layers(*each) for each in zip(*parts, strict=True)]
        bodies, size = start.shape[2] // 4, start.shape[2]
        states, mobility, weight = map(_in_blocks, (start, told[..., :bodies], told[..., bodies:]))
        models, blocks, pairs, _ = weight.shape
        states, real = states.reshape(models, blocks, 2, -1, LANES), states.dtype.type
        laws = [Law(*law, real(dt), every) for law in zip(mobility, weight, strict=True)]
        steps, back = stored * every + 1, any(ctx.needs_input_grad)
        places = np.empty((models, blocks, steps, 2 * bodies, LANES), real)
        slopes = np.empty((models, blocks, steps, pairs, ROWS, 2), real)
        shape = pairs, len(nets[0].last), ROWS, PANEL
        kept = Kept((2, models, blocks, steps, *shape), real) if back else None
        out = np.empty((models, blocks, stored + 1, 2, 2 * bodies, LANES), real)

        def trace(model: int, hidden: Array) -> Trace:
            return Trace(places[model], slopes[model], *hidden)

        def part(which: Some) -> int:
            spare = np.empty((2, 1, 1, *shape), real)
            for model, some in shares(which, blocks):
                left = trace(model, spare if kept is None else kept.array[:, model])
                forward_blocks(nets[model], laws[model], states[model], left, out[model], some)
            return 0

        in_threads(part, models * blocks)
        if kept is not None:
            ctx.save_for_backward(start, told, *weights)
            ctx.lengths, ctx.nets, ctx.laws, ctx.kept = lengths, nets, laws, kept
            ctx.traces = [trace(model, kept.array[:, model]) for model in range(models)]
        found = out.reshape(models, blocks, stored + 1, size, LANES).transpose(0, 1, 4, 2, 3)
        return torch.from_numpy(found.reshape(models, -1, stored + 1, size)[:, : start.shape[1]])

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        if torch.is_grad_enabled() or ctx.needs_input_grad[2]:  # the loops know but weights, start
            return None, *by_twin(partial(plainly, ctx.lengths), ctx.saved_tensors, upstream)
        start, _, first, *_ = ctx.saved_tensors
        above = _in_blocks(upstream.flatten(2))
        models, blocks = above.shape[:2]
        bodies, real = start.shape[2] // 4, above.dtype.type
        above = above.reshape(models, blocks, -1, 2, 2 * bodies, LANES)
        on_start = np.empty((models, blocks, 2, 2 * bodies, LANES), real)

        def back(model: int, some: Some, total: Layers) -> None:
            given = ctx.nets[model], ctx.laws[model], ctx.traces[model], above[model]
            backward_blocks(*given, on_start[model], total, some)

        form = partial(in_torchs_form, units=first.shape[1], inputs=first.shape[2])
        found = on_weights(ctx.nets, blocks, back, form)
        lanes = on_start.reshape(models, blocks, -1, LANES).transpose(0, 1, 3, 2)
        on_rows = torch.from_numpy(lanes.reshape(models, -1, 4 * bodies)[:, : start.shape[1]])
        return None, on_rows, None, *found


def _in_blocks(rows: Tensor) -> Array:
    """``(models, episodes, x)`` in blocks, the last filled up with zeros, ``(..., x, LANES)``."""
    # Always a copy: the loops move the start on where it lies.
    return np.array(in_tiles(rows, LANES).transpose(0, 1, 3, 2), order="C")
