"""A tanh network's input gradient, forward and back, in fused loops; torch's own is the twin.

It is what trains and rolls a learned force on a CPU: all pairs of all episodes are the rows of one
call, and the way back is written out, so that no graph of small operations is built.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function

from dynamics.compiled.lanes import Array
from dynamics.compiled.memory import Kept
from dynamics.compiled.panels import PANEL, ROWS, in_tiles, out_of_panels, out_of_tiles
from dynamics.compiled.rows import Layers, backward_rows, gradient_rows, layers, value_rows
from dynamics.compiled.shares import Some, by_twin, of_models, on_weights, shares
from dynamics.compiled.twin import plain_gradient
from loops.threads import in_threads

FEWEST_TILES = 16  # of outputs, that take a thread as long as its start


def input_gradient(x: Tensor, *weights: Tensor) -> Tensor:
    """Gradient of a network ``inputs -> units -> units -> 1`` with respect to its inputs.

    Args:
        x: rows, ``(rows, inputs)``.
        weights: both hidden layers' matrices and biases, and the last layer's matrix.
    """
    if not torch.is_grad_enabled():  # weights that learn would have memory kept for a way back
        x, weights = x.detach(), tuple(w.detach() for w in weights)
    return of_models(_Gradient, (), x, *weights)


def output(x: Tensor, *weights: Tensor) -> Tensor:
    """The network's output without its last bias, ``(rows, 1)``; there is no way back.

    Args:
        x, weights: see :func:`input_gradient`.
    """
    net, rows = layers(*(w.detach().numpy() for w in weights)), in_tiles(x.unsqueeze(0))[0]
    out = np.empty((len(rows), ROWS, 1), rows.dtype)
    in_threads(lambda some: value_rows(net, rows, out, some), len(rows), FEWEST_TILES)
    return torch.from_numpy(out).reshape(-1, 1)[: len(x)]


class _Gradient(Function):
    """Of models along a first axis: rows ``(models, rows, inputs)`` and likewise the weights."""

    @staticmethod
    def forward(ctx: Any, lengths: tuple[()], x: Tensor, *weights: Tensor) -> Tensor:
        parts = [w.detach().numpy() for w in weights]
        nets = [layers(*each) for each in zip(*parts, strict=True)]
        rows = in_tiles(x)
        models, tiles = rows.shape[:2]
        shape = 2, models, tiles, len(nets[0].last), ROWS, PANEL
        kept = Kept(shape, rows.dtype) if any(ctx.needs_input_grad) else None
        out = np.empty_like(rows)

        def part(which: Some) -> int:
            # Held by name: memory that is let go may be another thread's next.
            memory = kept or Kept((2, 1, 1, *shape[3:]), rows.dtype)
            hidden = memory.array
            for model, some in shares(which, tiles):
                at = 0 if kept is None else model
                gradient_rows(nets[model], rows[model], *hidden[:, at], out[model], some)
            return 0

        in_threads(part, models * tiles)
        if kept is not None:
            ctx.save_for_backward(x, *weights)
            ctx.nets, ctx.rows, ctx.hidden = nets, rows, kept
        return out_of_tiles(out, x)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        if torch.is_grad_enabled():
            return None, *by_twin(plain_gradient, ctx.saved_tensors, upstream)
        nets, rows, above, hidden = ctx.nets, ctx.rows, in_tiles(upstream), ctx.hidden.array
        on_rows = np.empty_like(rows)

        def back(model: int, some: Some, total: Layers) -> None:
            given = nets[model], rows[model], *hidden[:, model], above[model]
            backward_rows(*given, on_rows[model], total, some)

        x, first, *_ = ctx.saved_tensors
        form = partial(in_torchs_form, units=first.shape[1], inputs=first.shape[2])
        return None, out_of_tiles(on_rows, x), *on_weights(nets, rows.shape[1], back, form)


def in_torchs_form(totals: list[Layers], units: int, inputs: int) -> list[Array]:
    """Gradients of the weights, summed over threads, as torch keeps the weights."""
    first, first_bias, up, _, bias, last, _ = (sum(x[1:], x[0]) for x in zip(*totals, strict=True))
    return [
        first.reshape(inputs, -1).T[:units],
        first_bias.reshape(-1)[:units],
        out_of_panels(up).T[:units, :units],
        bias.reshape(-1)[:units],
        last.reshape(1, -1)[:, :units],
    ]
