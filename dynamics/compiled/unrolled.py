"""A residual map's rollout that can be differentiated, in fused loops; torch's own is the twin.

It is what trains an unstructured map on a CPU: all steps of a tile of rows in one call, and the way
back through them in another. See :mod:`dynamics.compiled.residual`.
"""

from __future__ import annotations

from functools import partial
from itertools import chain
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function
from torch.nn.functional import linear, silu

from dynamics.compiled.lanes import Array
from dynamics.compiled.memory import Kept
from dynamics.compiled.panels import PANEL, ROWS, in_tiles, out_of_tiles
from dynamics.compiled.residual import Net, backward_rows, forward_rows, net_of, weights_of
from dynamics.compiled.shares import Some, by_twin, of_models, on_weights, shares
from dynamics.mlp import MLP
from loops.threads import in_threads


def unrolled(
    network: MLP, scale: Tensor, start: Tensor, known: Tensor, stored: int, every: int
) -> Tensor:
    """Steps of x' = x + scale * network(x, known).

    Args:
        network: of silu layers of one width, at least two.
        scale: of each entry of the state, ``(entries,)``.
        start: ``(rows, entries)``.
        known: ``(rows, conditions)``.
        stored: states that are stored after the start.
        every: steps between them.

    Returns:
        States, ``(stored + 1, rows, entries)``.
    """
    weights = [x for layer in network.layers for x in layer.parameters()]
    rows = torch.cat([start, known], -1)
    return of_models(_Unrolled, (stored, every), scale, rows, *weights)


def plainly(lengths: tuple[int, int], scale: Tensor, x: Tensor, *weights: Tensor) -> Tensor:
    """The same by torch's own operations, of models along a first axis; see :class:`_Unrolled`."""
    (stored, every), found = lengths, []
    for model in range(len(x)):
        size, now = scale[model], x[model]
        layers = [(w[model], b[model]) for w, b in zip(weights[::2], weights[1::2], strict=True)]
        states = [now[:, : len(size)]]
        for step in range(stored * every):
            value = now
            for matrix, bias in layers[:-1]:
                value = silu(linear(value, matrix, bias))
            state = now[:, : len(size)] + size * linear(value, *layers[-1])
            now = torch.cat([state, now[:, len(size) :]], -1)
            if (step + 1) % every == 0:
                states.append(state)
        found.append(torch.stack(states))
    return torch.stack(found)


class _Unrolled(Function):
    """Of models along a first axis.

    Scales ``(models, entries)``, rows ``(models, rows, entries + conditions)`` and, of each layer,
    a matrix and a bias; gives ``(models, stored + 1, rows, entries)``.
    """

    @staticmethod
    def forward(
        ctx: Any, lengths: tuple[int, int], scale: Tensor, x: Tensor, *weights: Tensor
    ) -> Tensor:
        stored, every = lengths
        parts = [w.detach().numpy() for w in weights]
        nets = [net_of(list(p[::2]), list(p[1::2])) for p in zip(*parts, strict=True)]
        # A copy: the loops move the rows on where they lie.
        sizes, rows = np.ascontiguousarray(scale.detach().numpy()), in_tiles(x).copy()
        models, tiles = rows.shape[:2]
        steps = stored * every
        back = any(ctx.needs_input_grad)
        shape = len(nets[0].up), nets[0].biases.shape[1], ROWS, PANEL
        hidden = Kept((models, tiles, steps, *shape), rows.dtype) if back else None
        seen = np.empty((models, tiles, steps if back else 0, *rows.shape[2:]), rows.dtype)
        out = np.empty((models, stored + 1, tiles, ROWS, sizes.shape[1]), rows.dtype)

        def part(which: Some) -> int:
            spare = np.empty((1, *shape), rows.dtype)
            for model, (begin, end) in shares(which, tiles):
                for tile in range(begin, end):
                    kept = spare if hidden is None else hidden.array[model, tile]
                    here, told = rows[model, tile], seen[model, tile]
                    forward_rows(
                        nets[model], sizes[model], here, every, told, kept, out[model], tile
                    )
            return 0

        in_threads(part, models * tiles)
        if back:
            ctx.save_for_backward(scale, x, *weights)
            ctx.lengths, ctx.nets, ctx.seen, ctx.hidden = lengths, nets, seen, hidden
        return torch.from_numpy(out).reshape(models, stored + 1, -1, sizes.shape[1])[
            :, :, : x.shape[1]
        ]

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        if torch.is_grad_enabled() or ctx.needs_input_grad[1]:  # the loops know none of the sizes
            return None, *by_twin(partial(plainly, ctx.lengths), ctx.saved_tensors, upstream)
        nets, seen, hidden, every = ctx.nets, ctx.seen, ctx.hidden.array, ctx.lengths[1]
        scale, x, *weights = ctx.saved_tensors
        sizes = np.ascontiguousarray(scale.numpy())
        models, tiles = seen.shape[:2]
        above = in_tiles(upstream.flatten(0, 1)).reshape(models, -1, tiles, ROWS, sizes.shape[1])
        on_x = np.empty((models, tiles, ROWS, x.shape[2]), seen.dtype)

        def back(model: int, some: Some, total: Net) -> None:
            for tile in range(*some):
                told, kept, here = seen[model, tile], hidden[model, tile], on_x[model, tile]
                backward_rows(
                    nets[model], sizes[model], every, told, kept, above[model], here, total, tile
                )

        form = partial(_in_torchs_form, units=weights[0].shape[1])
        return None, None, out_of_tiles(on_x, x), *on_weights(nets, tiles, back, form)


def _in_torchs_form(totals: list[Net], units: int) -> list[Array]:
    """Gradients of the weights, summed over threads, as torch keeps the weights."""
    whole = Net(*(sum(x[1:], x[0]) for x in zip(*totals, strict=True)))
    return list(chain.from_iterable(zip(*weights_of(whole, units), strict=True)))
