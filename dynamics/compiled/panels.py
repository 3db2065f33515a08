"""Products of matrices that lie in panels, for numba: those of a network's training.

Values of a layer lie in panels of ``PANEL`` units, ``(panels, ROWS, PANEL)``, and matrices in
panels of outputs, ``(panels, inputs, PANEL)``: every innermost loop runs over numbers side by side,
there and back, and nothing is ever transposed. A block's sums are kept in registers.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from dynamics.compiled.lanes import Array
from loops.kernels import kernel, summing

ROWS, PANEL = 64, 32
BLOCK = 8  # rows whose sums with a panel fit into the registers together


def in_panels(matrix: Array) -> Array:
    """``(inputs, outputs) -> (panels, inputs, PANEL)``."""
    return np.ascontiguousarray(matrix.reshape(len(matrix), -1, PANEL).transpose(1, 0, 2))


def out_of_panels(panels: Array) -> Array:
    """Inverse of :func:`in_panels`."""
    return panels.transpose(1, 0, 2).reshape(panels.shape[1], -1)


def in_tiles(x: Tensor, size: int = ROWS) -> Array:
    """Rows ``(models, rows, n)`` in tiles, ``(models, tiles, size, n)``; zeros fill up the last.

    It is a view of the same memory where that can be.
    """
    rows = x.detach().numpy()
    if missing := -rows.shape[1] % size:
        rows = np.pad(rows, ((0, 0), (0, missing), (0, 0)))
    return np.ascontiguousarray(rows).reshape(len(rows), -1, size, rows.shape[2])


def out_of_tiles(tiles: Array, like: Tensor) -> Tensor:
    """Inverse of :func:`in_tiles`: as many rows and numbers as another tensor has."""
    return torch.from_numpy(tiles).reshape(len(tiles), -1, like.shape[-1])[:, : like.shape[1]]


@kernel
def enter(first: Array, bias: Array, x: Array, sums: Array, out: Array) -> None:
    """``x @ first + bias`` of few inputs, ``(ROWS, inputs)`` to panels; see :func:`times`."""
    for p in range(out.shape[0]):
        for row in range(0, ROWS, BLOCK):
            for lane in range(PANEL):
                start = bias[p, lane]
                sums[lane] = start
                sums[PANEL + lane] = start
                sums[2 * PANEL + lane] = start
                sums[3 * PANEL + lane] = start
                sums[4 * PANEL + lane] = start
                sums[5 * PANEL + lane] = start
                sums[6 * PANEL + lane] = start
                sums[7 * PANEL + lane] = start
            for j in range(first.shape[0]):
                x0, x1, x2, x3 = x[row, j], x[row + 1, j], x[row + 2, j], x[row + 3, j]
                x4, x5, x6, x7 = x[row + 4, j], x[row + 5, j], x[row + 6, j], x[row + 7, j]
                for lane in range(PANEL):
                    w = first[j, p, lane]
                    sums[lane] += x0 * w
                    sums[PANEL + lane] += x1 * w
                    sums[2 * PANEL + lane] += x2 * w
                    sums[3 * PANEL + lane] += x3 * w
                    sums[4 * PANEL + lane] += x4 * w
                    sums[5 * PANEL + lane] += x5 * w
                    sums[6 * PANEL + lane] += x6 * w
                    sums[7 * PANEL + lane] += x7 * w
            for lane in range(PANEL):
                out[p, row, lane] = sums[lane]
                out[p, row + 1, lane] = sums[PANEL + lane]
                out[p, row + 2, lane] = sums[2 * PANEL + lane]
                out[p, row + 3, lane] = sums[3 * PANEL + lane]
                out[p, row + 4, lane] = sums[4 * PANEL + lane]
                out[p, row + 5, lane] = sums[5 * PANEL + lane]
                out[p, row + 6, lane] = sums[6 * PANEL + lane]
                out[p, row + 7, lane] = sums[7 * PANEL + lane]


@summing
def leave(first: Array, values: Array, out: Array) -> None:
    """``values @ first.T``: panels to ``(ROWS, inputs)``."""
    zero = values.dtype.type(0)
    for row in range(0, ROWS, BLOCK):
        for j in range(first.shape[0]):
            t0 = t1 = t2 = t3 = t4 = t5 = t6 = t7 = zero
            for p in range(values.shape[0]):
                # Rows side by side: the sums of a row alone would become no vectors.
                for lane in range(PANEL):
                    w = first[j, p, lane]
                    t0 += values[p, row, lane] * w
                    t1 += values[p, row + 1, lane] * w
                    t2 += values[p, row + 2, lane] * w
                    t3 += values[p, row + 3, lane] * w
                    t4 += values[p, row + 4, lane] * w
                    t5 += values[p, row + 5, lane] * w
                    t6 += values[p, row + 6, lane] * w
                    t7 += values[p, row + 7, lane] * w
            out[row, j], out[row + 1, j], out[row + 2, j], out[row + 3, j] = t0, t1, t2, t3
            out[row + 4, j], out[row + 5, j], out[row + 6, j], out[row + 7, j] = t4, t5, t6, t7


@kernel
def times(values: Array, matrix: Array, bias: Array, sums: Array, out: Array) -> None:
    """``values @ matrix + bias``, panels to panels.

    Args:
        sums: ``(BLOCK * PANEL,)`` of scratch, which the compiler keeps in registers.
    """
    for p in range(matrix.shape[0]):
        for row in range(0, ROWS, BLOCK):
            for lane in range(PANEL):
                start = bias[p, lane]
                sums[lane] = start
                sums[PANEL + lane] = start
                sums[2 * PANEL + lane] = start
                sums[3 * PANEL + lane] = start
                sums[4 * PANEL + lane] = start
                sums[5 * PANEL + lane] = start
                sums[6 * PANEL + lane] = start
                sums[7 * PANEL + lane] = start
            for q in range(values.shape[0]):
                for j in range(PANEL):
                    x0, x1 = values[q, row, j], values[q, row + 1, j]
                    x2, x3 = values[q, row + 2, j], values[q, row + 3, j]
                    x4, x5 = values[q, row + 4, j], values[q, row + 5, j]
                    x6, x7 = values[q, row + 6, j], values[q, row + 7, j]
                    # One loop, written out: so it becomes 16 vectors that stay where they are.
                    for lane in range(PANEL):
                        w = matrix[p, q * PANEL + j, lane]
                        sums[lane] += x0 * w
                        sums[PANEL + lane] += x1 * w
                        sums[2 * PANEL + lane] += x2 * w
                        sums[3 * PANEL + lane] += x3 * w
                        sums[4 * PANEL + lane] += x4 * w
                        sums[5 * PANEL + lane] += x5 * w
                        sums[6 * PANEL + lane] += x6 * w
                        sums[7 * PANEL + lane] += x7 * w
            for lane in range(PANEL):
                out[p, row, lane] = sums[lane]
                out[p, row + 1, lane] = sums[PANEL + lane]
                out[p, row + 2, lane] = sums[2 * PANEL + lane]
                out[p, row + 3, lane] = sums[3 * PANEL + lane]
                out[p, row + 4, lane] = sums[4 * PANEL + lane]
                out[p, row + 5, lane] = sums[5 * PANEL + lane]
                out[p, row + 6, lane] = sums[6 * PANEL + lane]
                out[p, row + 7, lane] = sums[7 * PANEL + lane]


@kernel
def _outer_block(left: Array, right: Array, j: int, sums: Array) -> None:
    """Add the products of ``BLOCK`` units and a panel, summed over rows."""
    for row in range(ROWS):
        x0, x1, x2, x3 = left[row, j], left[row, j + 1], left[row, j + 2], left[row, j + 3]
        x4, x5, x6, x7 = left[row, j + 4], left[row, j + 5], left[row, j + 6], left[row, j + 7]
        for lane in range(PANEL):
            w = right[row, lane]
            sums[lane] += x0 * w
            sums[PANEL + lane] += x1 * w
            sums[2 * PANEL + lane] += x2 * w
            sums[3 * PANEL + lane] += x3 * w
            sums[4 * PANEL + lane] += x4 * w
            sums[5 * PANEL + lane] += x5 * w
            sums[6 * PANEL + lane] += x6 * w
            sums[7 * PANEL + lane] += x7 * w


@kernel
def outer(a: Array, b: Array, sums: Array, total: Array) -> None:
    """Add ``a.T @ b``, of panels, to a matrix in panels, ``(panels, units, PANEL)``."""
    for p in range(total.shape[0]):
        for q in range(a.shape[0]):
            for j in range(0, PANEL, BLOCK):
                at = q * PANEL + j
                for lane in range(PANEL):
                    sums[lane] = total[p, at, lane]
                    sums[PANEL + lane] = total[p, at + 1, lane]
                    sums[2 * PANEL + lane] = total[p, at + 2, lane]
                    sums[3 * PANEL + lane] = total[p, at + 3, lane]
                    sums[4 * PANEL + lane] = total[p, at + 4, lane]
                    sums[5 * PANEL + lane] = total[p, at + 5, lane]
                    sums[6 * PANEL + lane] = total[p, at + 6, lane]
                    sums[7 * PANEL + lane] = total[p, at + 7, lane]
                _outer_block(a[q], b[p], j, sums)
                for lane in range(PANEL):
                    total[p, at, lane] = sums[lane]
                    total[p, at + 1, lane] = sums[PANEL + lane]
                    total[p, at + 2, lane] = sums[2 * PANEL + lane]
                    total[p, at + 3, lane] = sums[3 * PANEL + lane]
                    total[p, at + 4, lane] = sums[4 * PANEL + lane]
                    total[p, at + 5, lane] = sums[5 * PANEL + lane]
                    total[p, at + 6, lane] = sums[6 * PANEL + lane]
                    total[p, at + 7, lane] = sums[7 * PANEL + lane]


@kernel
def enter_back(values: Array, x: Array, sums: Array, total: Array) -> None:
    """Add ``x.T @ values`` to a matrix of few inputs, ``(inputs, panels, PANEL)``."""
    for p in range(values.shape[0]):
        for i in range(total.shape[0]):
            for lane in range(PANEL):
                sums[lane] = total[i, p, lane]
            for row in range(0, ROWS, 4):
                x0, x1, x2, x3 = x[row, i], x[row + 1, i], x[row + 2, i], x[row + 3, i]
                for lane in range(PANEL):
                    first = x0 * values[p, row, lane] + x1 * values[p, row + 1, lane]
                    second = x2 * values[p, row + 2, lane] + x3 * values[p, row + 3, lane]
                    sums[lane] += first + second
            for lane in range(PANEL):
                total[i, p, lane] = sums[lane]
