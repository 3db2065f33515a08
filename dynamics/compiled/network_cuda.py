"""A tanh network's input gradient on CUDA, forward and back, by Triton; torch's own is the twin.

It is what trains and rolls a learned force on a card, as :mod:`dynamics.compiled.gradient` is on a
CPU. The kernels run in Triton's interpreter too, on the CPU, which is how they are tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import triton
from torch import Tensor
from torch.autograd import Function
from triton.runtime.errors import OutOfResources

from dynamics.compiled import network_kernel as kernels
from dynamics.compiled.shares import by_twin, of_models
from dynamics.compiled.twin import plain_gradient

LEAST = 16  # rows, columns and sums of a product of matrices
BLOCKS = 128, 64, 32, LEAST  # of a layer's inputs, that a product sums up at once
ROWS = LEAST  # of inputs, in a program: of more, too much would have to be held
SUMMED = 32  # rows, that the square layer's gradient sums up at once
TILE = 128  # units each way, of a part of that gradient
# The fastest of seven and of six that were tried.
ROW_WISE = {"R": ROWS, "num_warps": 4, "num_stages": 2}
SQUARE = {"BLOCK": SUMMED, "num_warps": 8, "num_stages": 3}
PROGRAMS = 264  # that share out its sums over rows: two for each processor of a large card


def packed(*weights: Tensor) -> tuple[Tensor, Tensor]:
    """What kernels read of networks: a table of vectors of units, and the square layer in halves.

    Args:
        weights: of models along a first axis, both hidden layers' matrices and biases, and the
            last layer's matrix. Units are padded to a power of 2 with some that are fed and heard
            by nobody: their weights are zero.
    """
    models, units = weights[1].shape
    width = max(triton.next_power_of_2(units), LEAST)
    table = weights[0].new_empty(models, kernels.VECTORS.value, width)
    matrix = table.new_empty(models, 2, width, width, dtype=torch.float16)
    given = [w.detach().contiguous() for w in weights]
    with torch.cuda.device_of(table):
        kernels.pack[(width // LEAST, models)](
            *given, table, matrix, units, WIDTH=width, BLOCK=LEAST
        )
    return table, matrix


def largest_block(
    kernel: Any,
    grid: tuple[int, ...],
    given: Sequence[Any],
    width: int,
    blocks: Sequence[int],
    **sizes: int,
) -> None:
    """Run a kernel with the largest blocks that the card's processors have memory for.

    Args:
        kernel: takes ``WIDTH`` and ``BLOCK``, which is at most as large.
        grid: of programs.
        given: what it is handed, a tensor first.
        width: of the network, a power of 2.
        blocks: that are worth while, from large to small.
        sizes: the kernel's other constants, and how Triton is to compile it.

    Raises:
        OutOfResources: there is no room for the smallest either.
    """
    with torch.cuda.device_of(given[0]):
        for block in (each for each in blocks if each <= width):
            try:
                kernel[grid](*given, WIDTH=width, BLOCK=block, **sizes)
                return
            except OutOfResources:
                if block == blocks[-1]:
                    raise


def input_gradient(x: Tensor, *weights: Tensor) -> Tensor:
    """See :func:`dynamics.compiled.gradient.input_gradient`; rows of two inputs, float32.

    A derivative of the way back goes through the twin.
    """
    if not torch.is_grad_enabled():
        x, weights = x.detach(), tuple(w.detach() for w in weights)
    return of_models(_Gradient, (), x, *weights)


class _Gradient(Function):
    """Of models along a first axis: rows ``(models, rows, 2)`` and likewise the weights."""

    @staticmethod
    def forward(ctx: Any, lengths: tuple[()], x: Tensor, *weights: Tensor) -> Tensor:
        ctx.save_for_backward(x, *weights)
        x = x.detach().contiguous()
        models, rows, _ = x.shape
        table, matrix = packed(*weights)
        width, keep = table.shape[-1], any(ctx.needs_input_grad)
        kept = x.new_empty(2, models, rows, width) if keep else x
        out, beside = torch.empty_like(x), models * rows * width if keep else 0
        grid = triton.cdiv(rows, ROWS), models
        given = x, table, matrix, out, kept, rows, beside
        largest_block(kernels.forward, grid, given, width, BLOCKS[1:], **ROW_WISE)
        ctx.made = x, table, matrix, kept
        return out

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        if torch.is_grad_enabled():
            return None, *by_twin(plain_gradient, ctx.saved_tensors, upstream)
        x, table, matrix, kept = ctx.made
        (models, rows, _), width, units = x.shape, table.shape[-1], ctx.saved_tensors[1].shape[1]
        above, programs = upstream.contiguous(), triton.cdiv(rows, ROWS)
        pull, on_x = torch.empty_like(kept[0]), torch.empty_like(x)
        sums = x.new_empty(models, programs, kernels.SUMS.value, width)
        given = x, above, table, matrix, kept, pull, on_x, sums, rows, models * rows * width
        largest_block(kernels.back, (programs, models), given, width, BLOCKS[1:], **ROW_WISE)
        size = table[:, 5, :1]  # of the last layer
        u, v, first_bias, bias, last = sums.sum(1)[..., :units].unbind(1)
        first = torch.stack([u, v], -1) * size.unsqueeze(-1)
        square = _on_square(x, above, table, kept, pull)[..., :units, :units]
        return None, on_x, first, first_bias * size, square, bias * size, last.unsqueeze(1)


def _on_square(x: Tensor, above: Tensor, table: Tensor, kept: Tensor, pull: Tensor) -> Tensor:
    """The gradient of the layer between the hidden ones, ``(models, width, width)``."""
    (models, rows, _), width = x.shape, table.shape[-1]
    tile = min(TILE, width)
    tiles = (width // tile) ** 2
    share = SUMMED * triton.cdiv(rows, SUMMED * max(1, PROGRAMS // (tiles * models)))
    shares = triton.cdiv(rows, share)
    parts = x.new_empty(models, shares, width, width)
    largest = torch.linalg.vector_norm(above, torch.inf, (1, 2))
    given = x, above, largest, table, kept, pull, parts, rows, share
    kernels.square[(tiles, shares, models)](*given, WIDTH=width, TILE=tile, **SQUARE)
    return parts.sum(1)
