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
from dynamics.compiled.panels import PANEL, ROWS, out_of_panels
from dynamics.compiled.rows import Layers, backward_rows, gradient_rows, layers, value_rows
from dynamics.compiled.shares import Some, on_weights, shares
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
    if torch._C._functorch.peek_interpreter_stack() is not None:
        return _Mapped.apply(x, *weights)
    return _Gradient.apply(x.unsqueeze(0), *(w.unsqueeze(0) for w in weights)).squeeze(0)


def output(x: Tensor, *weights: Tensor) -> Tensor:
    """The network's output without its last bias, ``(rows, 1)``; there is no way back.

    Args:
        x, weights: see :func:`input_gradient`.
    """
    net, rows = layers(*(w.detach().numpy() for w in weights)), _tiled(x.unsqueeze(0))[0]
    out = np.empty((len(rows), ROWS, 1), rows.dtype)
    in_threads(lambda some: value_rows(net, rows, out, some), len(rows), FEWEST_TILES)
    return torch.from_numpy(out).reshape(-1, 1)[: len(x)]


def plain_gradient(
    x: Tensor, first: Tensor, first_bias: Tensor, square: Tensor, bias: Tensor, last: Tensor
) -> Tensor:
    """The same by torch's own operations, which can be differentiated again."""
    low = torch.tanh(x @ first.mT + first_bias.unsqueeze(-2))
    top = torch.tanh(low @ square.mT + bias.unsqueeze(-2))
    return ((last * (1 - top.square())) @ square * (1 - low.square())) @ first


class _Mapped(Function):
    """The same for several models side by side, each with its own weights."""

    @staticmethod
    def forward(x: Tensor, *weights: Tensor) -> Tensor:
        return input_gradient(x, *weights)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        """Nothing is kept here: what :meth:`vmap` calls has its own way back."""

    @staticmethod
    def vmap(info: Any, dims: tuple[Any, ...], *parts: Tensor) -> tuple[Tensor, int]:
        """All models in one call."""
        every = (
            part.expand(info.batch_size, *part.shape) if dim is None else part.movedim(dim, 0)
            for part, dim in zip(parts, dims, strict=True)
        )
        return _Gradient.apply(*every), 0


class _Gradient(Function):
    """Of models along a first axis: rows ``(models, rows, inputs)`` and likewise the weights."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, *weights: Tensor) -> Tensor:
        parts = [w.detach().numpy() for w in weights]
        nets = [layers(*each) for each in zip(*parts, strict=True)]
        rows = _tiled(x)
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
                gradient_rows(
                    nets[model], rows[model], hidden[0, at], hidden[1, at], out[model], some
                )
            return 0

        in_threads(part, models * tiles)
        if kept is not None:
            ctx.save_for_backward(x, *weights)
            ctx.nets, ctx.rows, ctx.hidden = nets, rows, kept
        return _untiled(out, x)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        if torch.is_grad_enabled():
            return tuple(_differentiable(ctx.saved_tensors, upstream))
        nets, rows, above, hidden = ctx.nets, ctx.rows, _tiled(upstream), ctx.hidden.array
        on_rows = np.empty_like(rows)

        def back(model: int, some: Some, total: Layers) -> None:
            backward_rows(
                nets[model],
                rows[model],
                hidden[0, model],
                hidden[1, model],
                above[model],
                on_rows[model],
                total,
                some,
            )

        x, first, *_ = ctx.saved_tensors
        form = partial(in_torchs_form, units=first.shape[1], inputs=first.shape[2])
        found = on_weights(nets, rows.shape[1], back, form)
        return _untiled(on_rows, x), *found


def _differentiable(given: tuple[Tensor, ...], upstream: Tensor) -> list[Tensor | None]:
    """The way back by the twin, through which another derivative can go."""
    needed = [tensor for tensor in given if tensor.requires_grad]
    found = torch.autograd.grad(plain_gradient(*given), needed, upstream, create_graph=True)
    left = iter(found)
    return [next(left) if tensor.requires_grad else None for tensor in given]


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


def _tiled(x: Tensor) -> Array:
    """Rows in tiles, the last filled up with zeros, ``(models, tiles, ROWS, inputs)``."""
    rows = x.detach().numpy()
    if missing := -rows.shape[1] % ROWS:
        rows = np.pad(rows, ((0, 0), (0, missing), (0, 0)))
    return np.ascontiguousarray(rows).reshape(len(rows), -1, ROWS, rows.shape[2])


def _untiled(tiles: Array, like: Tensor) -> Tensor:
    return torch.from_numpy(tiles).reshape(len(tiles), -1, like.shape[-1])[:, : like.shape[1]]
