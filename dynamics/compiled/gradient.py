"""A tanh network's input gradient, forward and back, in fused loops; torch's own is the twin.

It is what trains and rolls a learned force on a CPU: all pairs of all episodes are the rows of one
call, and the way back is written out, so that no graph of small operations is built.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function
from torch.nn.functional import linear

from dynamics.compiled.cpu import in_threads
from dynamics.compiled.lanes import Array
from dynamics.compiled.panels import PANEL, ROWS, out_of_panels
from dynamics.compiled.rows import Layers, backward_rows, gradient_rows, layers


def input_gradient(x: Tensor, *weights: Tensor) -> Tensor:
    """Gradient of a network ``inputs -> units -> units -> 1`` with respect to its inputs.

    Args:
        x: rows, ``(rows, inputs)``.
        weights: both hidden layers' matrices and biases, and the last layer's matrix.
    """
    function = _Gradient if torch._C._functorch.peek_interpreter_stack() is None else _Mapped
    return function.apply(x, *weights)


def plain_gradient(
    x: Tensor, first: Tensor, first_bias: Tensor, square: Tensor, bias: Tensor, last: Tensor
) -> Tensor:
    """The same by torch's own operations, which can be differentiated again."""
    low = torch.tanh(linear(x, first, first_bias))
    top = torch.tanh(linear(low, square, bias))
    return ((last * (1 - top.square())) @ square * (1 - low.square())) @ first


def can_run(x: Tensor) -> bool:
    """Whether rows are in single precision on the CPU, and are mapped over at most once."""
    if x.device.type != "cpu" or x.dtype != torch.float32 or torch.compiler.is_compiling():
        return False
    stack = torch._C._functorch.get_interpreter_stack()
    return stack is None or [each.key().name for each in stack] == ["Vmap"]


class _Mapped(Function):
    """The same for several models side by side, each with its own weights."""

    @staticmethod
    def forward(x: Tensor, *weights: Tensor) -> Tensor:
        return _Gradient.apply(x, *weights)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        """Nothing is kept here: what :meth:`vmap` calls has its own way back."""

    @staticmethod
    def vmap(info: Any, dims: tuple[Any, ...], *parts: Tensor) -> tuple[Tensor, int]:
        """A call for each model."""
        each = [
            [part] * info.batch_size if dim is None else part.unbind(dim)
            for part, dim in zip(parts, dims, strict=True)
        ]
        return torch.stack([_Gradient.apply(*one) for one in zip(*each, strict=True)]), 0


class _Gradient(Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, *weights: Tensor) -> Tensor:
        net = layers(*(w.detach().numpy() for w in weights))
        rows = _tiled(x)
        kept = _Hidden(rows, len(net.last)) if any(ctx.needs_input_grad) else None
        out = np.empty_like(rows)

        def part(tiles: tuple[int, int]) -> int:
            hidden = kept or _Hidden(rows[:1], len(net.last))
            return gradient_rows(net, rows, *hidden.layers, out, tiles)

        in_threads(part, len(rows))
        if kept is not None:
            ctx.save_for_backward(x, *weights)
            ctx.net, ctx.rows, ctx.hidden = net, rows, kept
        return _untiled(out, x)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        if torch.is_grad_enabled():
            return tuple(_differentiable(ctx.saved_tensors, upstream))
        net, rows, above = ctx.net, ctx.rows, _tiled(upstream)
        on_rows = np.empty_like(rows)

        def part(tiles: tuple[int, int]) -> Layers:
            total = Layers(*(np.zeros_like(w) for w in net))
            backward_rows(net, rows, *ctx.hidden.layers, above, on_rows, total, tiles)
            return total

        totals = in_threads(part, len(rows))
        x, first, *_ = ctx.saved_tensors
        return _untiled(on_rows, x), *_as_torch(totals, *first.shape)


def _differentiable(given: tuple[Tensor, ...], upstream: Tensor) -> list[Tensor | None]:
    """The way back by the twin, through which another derivative can go."""
    needed = [tensor for tensor in given if tensor.requires_grad]
    found = torch.autograd.grad(plain_gradient(*given), needed, upstream, create_graph=True)
    left = iter(found)
    return [next(left) if tensor.requires_grad else None for tensor in given]


def _as_torch(totals: list[Layers], units: int, inputs: int) -> list[Tensor]:
    """Gradients of the weights, summed over threads, in the form of torch's own."""
    first, first_bias, up, _, bias, last, _ = (sum(x[1:], x[0]) for x in zip(*totals, strict=True))
    found = (
        first.reshape(inputs, -1).T[:units],
        first_bias.reshape(-1)[:units],
        out_of_panels(up).T[:units, :units],
        bias.reshape(-1)[:units],
        last.reshape(1, -1)[:, :units],
    )
    return [torch.from_numpy(np.ascontiguousarray(x)) for x in found]


def _tiled(x: Tensor) -> Array:
    """Rows in tiles, the last one filled up with zeros, ``(tiles, ROWS, inputs)``."""
    rows = x.detach().numpy()
    if missing := -len(rows) % ROWS:
        rows = np.pad(rows, ((0, missing), (0, 0)))
    return np.ascontiguousarray(rows).reshape(-1, ROWS, rows.shape[1])


def _untiled(tiles: Array, like: Tensor) -> Tensor:
    return torch.from_numpy(tiles).reshape(-1, like.shape[-1])[: len(like)]


MOST_SPARE = 2**28  # bytes
_spare: dict[tuple[Any, ...], list[Array]] = {}


class _Hidden:
    """Memory for what the hidden layers of some tiles give; used again once it is let go.

    Fresh memory of this size costs a tenth of a training step in page faults.
    """

    def __init__(self, tiles: Array, panels: int) -> None:
        shape, dtype = (2, len(tiles), panels, ROWS, PANEL), tiles.dtype
        self.key = (shape, dtype)
        spare = _spare.get(self.key)
        self.layers = spare.pop() if spare else np.empty(shape, dtype)

    def __del__(self) -> None:
        held = sum(array.nbytes for arrays in _spare.values() for array in arrays)
        if held + self.layers.nbytes > MOST_SPARE:
            _spare.clear()
        _spare.setdefault(self.key, []).append(self.layers)
