"""Kernels of a tanh network's input gradient, forward and back; ``network_cuda`` calls them.

The network is ``2 -> units -> units -> 1``; a program has some rows of inputs, and reads the matrix
between the layers from the card's cache. Sums over rows are made within a program here, and over
programs by torch, always in one order.
"""

# Triton gives its own types to what a kernel is handed, and reads its annotations itself.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from typing import no_type_check

import triton
import triton.language as tl

# Of units: what a table holds of a network, and what the way back sums up.
VECTORS, SUMS = tl.constexpr(6), tl.constexpr(5)
SPLIT = tl.constexpr(2.0**11)
TINY = tl.constexpr(1e-30)


@triton.jit
@no_type_check
def _tanh(x):  # noqa: ANN001, ANN202
    return 1 - 2 / (tl.exp(2 * x) + 1)


@triton.jit
@no_type_check
def _halves(x):  # noqa: ANN001, ANN202
    """Two numbers of eleven bits, of which the second counts ``SPLIT`` times less."""
    most = x.to(tl.float16)
    return most, ((x - most.to(tl.float32)) * SPLIT).to(tl.float16)


@triton.jit
@no_type_check
def _added(total, small, x, large, rest):  # noqa: ANN001, ANN202
    """Products of ``x`` with a matrix, each in two halves of eleven bits, to within 2e-7 of it.

    The card multiplies such halves many times as fast as whole numbers, and sums them up whole.
    """
    most, left = _halves(x)
    return tl.dot(most, large, total), tl.dot(most, rest, tl.dot(left, large, small))


@triton.jit
@no_type_check
def _inputs(u, v, table, matrix, first, WIDTH: tl.constexpr, BLOCK: tl.constexpr):  # noqa: ANN001, ANN202, N803
    """Some units of the first layer, their slopes along u and v, and their rows of the matrix."""
    h, k = tl.arange(0, WIDTH), first + tl.arange(0, BLOCK)
    low, along, across = _first(u, v, table, k, WIDTH)
    at = matrix + k[:, None] * WIDTH + h[None, :]
    return low, along, across, tl.load(at), tl.load(at + WIDTH * WIDTH)


@triton.jit
@no_type_check
def _first(u, v, table, k, WIDTH: tl.constexpr):  # noqa: ANN001, ANN202, N803
    """Units ``k`` of the first layer, and their slopes along u and v."""
    of_u, of_v = tl.load(table + k)[None, :], tl.load(table + WIDTH + k)[None, :]
    low = _tanh(u * of_u + v * of_v + tl.load(table + 2 * WIDTH + k)[None, :])
    flat = 1 - low * low
    return low, flat * of_u, flat * of_v


@triton.jit
@no_type_check
def slopes(u, v, table, matrix, kept, beside, there, WIDTH: tl.constexpr, BLOCK: tl.constexpr):  # noqa: ANN001, ANN201, N803
    """Slopes along u and v of rows of inputs ``[rows, 1]``, but for the last layer's size.

    The matrix is gone through twice, ``BLOCK`` of its rows at a time.

    Args:
        kept: where a row's units of the second layer are kept, and ``beside`` them what comes down
            to its units of the first; ``there``: of which rows.
    """
    h = tl.arange(0, WIDTH)
    rows: tl.constexpr = u.shape[0]
    small = tl.zeros([rows, WIDTH], tl.float32)
    high = small + tl.load(table + 3 * WIDTH + h)[None, :]
    for first in range(0, WIDTH, BLOCK):
        low, _, _, large, rest = _inputs(u, v, table, matrix, first, WIDTH, BLOCK)
        high, small = _added(high, small, low, large, rest)
    high = _tanh(high + small * (1 / SPLIT))
    if beside > 0:
        tl.store(kept + h[None, :], high, there)
    slope = (1 - high * high) * tl.load(table + 4 * WIDTH + h)[None, :]
    to_u, to_v = tl.zeros([rows], tl.float32), tl.zeros([rows], tl.float32)
    for first in range(0, WIDTH, BLOCK):
        _, along, across, large, rest = _inputs(u, v, table, matrix, first, WIDTH, BLOCK)
        none = tl.zeros([rows, BLOCK], tl.float32)
        down, less = _added(none, none, slope, tl.trans(large), tl.trans(rest))
        down += less * (1 / SPLIT)
        if beside > 0:
            tl.store(kept + beside + (first + tl.arange(0, BLOCK))[None, :], down, there)
        to_u += tl.sum(down * along, 1)
        to_v += tl.sum(down * across, 1)
    return to_u, to_v


@triton.jit
@no_type_check
def forward(  # noqa: ANN201
    x, table, matrix, out, kept, rows, beside,  # noqa: ANN001
    WIDTH: tl.constexpr, R: tl.constexpr, BLOCK: tl.constexpr,  # noqa: N803
):  # fmt: skip
    """The input gradient of ``R`` rows of a model."""
    model = tl.program_id(1).to(tl.int64)
    row = tl.program_id(0) * R + tl.arange(0, R)
    there = row < rows
    place = model * rows + row
    u, v = tl.load(x + 2 * place, there, 0.0), tl.load(x + 2 * place + 1, there, 0.0)
    table += model * VECTORS * WIDTH
    matrix += model * 2 * WIDTH * WIDTH
    keep, of = kept + (place * WIDTH)[:, None], there[:, None]
    to_u, to_v = slopes(u[:, None], v[:, None], table, matrix, keep, beside, of, WIDTH, BLOCK)
    size = tl.load(table + 5 * WIDTH)
    tl.store(out + 2 * place, to_u * size, there)
    tl.store(out + 2 * place + 1, to_v * size, there)


@triton.jit
@no_type_check
def back(  # noqa: ANN201
    x, above, table, matrix, kept, pull, on_x, sums, rows, beside,  # noqa: ANN001
    WIDTH: tl.constexpr, R: tl.constexpr, BLOCK: tl.constexpr,  # noqa: N803
):  # fmt: skip
    """The way back of ``R`` rows: the gradient of x, sums over the rows, and ``pull``.

    That is what pulls at the second layer's sums, ``(rows, WIDTH)``. What comes from above is
    divided by its largest number, row by row, so that halves can hold what is made of it.
    """
    model = tl.program_id(1).to(tl.int64)
    row = tl.program_id(0) * R + tl.arange(0, R)
    there = row < rows
    place = model * rows + row
    at, below = 2 * place, there[:, None]
    u, v = tl.load(x + at, there, 0.0)[:, None], tl.load(x + at + 1, there, 0.0)[:, None]
    g, e = tl.load(above + at, there, 0.0), tl.load(above + at + 1, there, 0.0)
    most = tl.maximum(tl.maximum(tl.abs(g), tl.abs(e)), TINY)
    g, e, weight = (g / most)[:, None], (e / most)[:, None], most[:, None]
    table += model * VECTORS * WIDTH
    matrix += model * 2 * WIDTH * WIDTH
    keep = kept + (place * WIDTH)[:, None]
    sums += (model * tl.num_programs(0) + tl.program_id(0)) * SUMS * WIDTH
    h = tl.arange(0, WIDTH)
    up, small = tl.zeros([R, WIDTH], tl.float32), tl.zeros([R, WIDTH], tl.float32)
    for first in range(0, WIDTH, BLOCK):
        _, along, across, large, rest = _inputs(u, v, table, matrix, first, WIDTH, BLOCK)
        up, small = _added(up, small, g * along + e * across, large, rest)
    high = tl.load(keep + h[None, :], below, 0.0)
    up = (up + small * (1 / SPLIT)) * (1 - high * high)
    tl.store(sums + 4 * WIDTH + h, tl.sum(up * weight, 0))
    up = -2 * high * up * tl.load(table + 4 * WIDTH + h)[None, :]
    tl.store(pull + (place * WIDTH)[:, None] + h[None, :], up * weight, below)
    tl.store(sums + 3 * WIDTH + h, tl.sum(up * weight, 0))
    on_u, on_v = tl.zeros([R], tl.float32), tl.zeros([R], tl.float32)
    for first in range(0, WIDTH, BLOCK):
        k = first + tl.arange(0, BLOCK)
        low, along, across, large, rest = _inputs(u, v, table, matrix, first, WIDTH, BLOCK)
        none = tl.zeros([R, BLOCK], tl.float32)
        pulled, less = _added(none, none, up, tl.trans(large), tl.trans(rest))
        down = tl.load(keep + beside + k[None, :], below, 0.0)
        flat = 1 - low * low
        pulled = flat * (pulled + less * (1 / SPLIT)) - 2 * low * (g * along + e * across) * down
        on_u += tl.sum(pulled * tl.load(table + k)[None, :], 1)
        on_v += tl.sum(pulled * tl.load(table + WIDTH + k)[None, :], 1)
        pulled, down = pulled * weight, down * flat * weight
        tl.store(sums + k, tl.sum(pulled * u + down * g, 0))
        tl.store(sums + WIDTH + k, tl.sum(pulled * v + down * e, 0))
        tl.store(sums + 2 * WIDTH + k, tl.sum(pulled, 0))
    size = most * tl.load(table + 5 * WIDTH)
    tl.store(on_x + at, on_u * size, there)
    tl.store(on_x + at + 1, on_v * size, there)


@triton.jit
@no_type_check
def _summed(total, small, x, y):  # noqa: ANN001, ANN202
    """Products of two numbers of each row, summed over rows; see :func:`_added`."""
    most, left = _halves(x)
    large, rest = _halves(y)
    most = tl.trans(most)
    return tl.dot(most, large, total), tl.dot(most, rest, tl.dot(tl.trans(left), large, small))


@triton.jit
@no_type_check
def square(  # noqa: ANN201
    x, above, largest, table, kept, pull, parts, rows, share,  # noqa: ANN001
    WIDTH: tl.constexpr, TILE: tl.constexpr, BLOCK: tl.constexpr,  # noqa: N803
):  # fmt: skip
    """A share of the rows' sum to a tile of the square layer's gradient, into ``parts``."""
    model = tl.program_id(2).to(tl.int64)
    tiles: tl.constexpr = WIDTH // TILE
    o = tl.program_id(0) // tiles * TILE + tl.arange(0, TILE)
    k = tl.program_id(0) % tiles * TILE + tl.arange(0, TILE)
    table += model * VECTORS * WIDTH
    largest = tl.maximum(tl.load(largest + model), TINY)
    last = tl.load(table + 4 * WIDTH + o)[None, :]
    total, small = tl.zeros([TILE, TILE], tl.float32), tl.zeros([TILE, TILE], tl.float32)
    begin = tl.program_id(1) * share
    for first in range(begin, begin + share, BLOCK):
        row = first + tl.arange(0, BLOCK)
        there = row < tl.minimum(rows, begin + share)
        place = model * rows + row
        u, v = tl.load(x + 2 * place, there, 0.0), tl.load(x + 2 * place + 1, there, 0.0)
        g, e = tl.load(above + 2 * place, there, 0.0), tl.load(above + 2 * place + 1, there, 0.0)
        low, along, across = _first(u[:, None], v[:, None], table, k, WIDTH)
        turned = (g / largest)[:, None] * along + (e / largest)[:, None] * across
        at = (place * WIDTH)[:, None] + o[None, :]
        high = tl.load(kept + at, there[:, None], 0.0)
        pulled = tl.load(pull + at, there[:, None], 0.0) / largest
        total, small = _summed(total, small, (1 - high * high) * last, turned)
        total, small = _summed(total, small, pulled, low)
    to = parts + (model * tl.num_programs(1) + tl.program_id(1)) * WIDTH * WIDTH
    scale = largest * tl.load(table + 5 * WIDTH)
    tl.store(to + o[:, None] * WIDTH + k[None, :], (total + small * (1 / SPLIT)) * scale)


@triton.jit
@no_type_check
def pack(  # noqa: ANN201
    first, first_bias, square, bias, last, table, matrix, units,  # noqa: ANN001
    WIDTH: tl.constexpr, BLOCK: tl.constexpr,  # noqa: N803
):  # fmt: skip
    """A table of a network's vectors, and its matrix in halves, from the first layer's units."""
    model = tl.program_id(1).to(tl.int64)
    h, k = tl.arange(0, WIDTH), tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    real = k < units
    at = square + model * units * units + h[None, :] * units + k[:, None]
    large, rest = _halves(tl.load(at, real[:, None] & (h < units)[None, :], 0.0))
    to = matrix + model * 2 * WIDTH * WIDTH + k[:, None] * WIDTH + h[None, :]
    tl.store(to, large)
    tl.store(to + WIDTH * WIDTH, rest)
    last += model * units
    # Apart, so that halves can hold the rest.
    size = tl.maximum(tl.max(tl.abs(tl.load(last + h, h < units, 0.0))), TINY)
    table += model * VECTORS * WIDTH + k
    inputs = first + model * 2 * units + 2 * k
    tl.store(table, tl.load(inputs, real, 0.0))
    tl.store(table + WIDTH, tl.load(inputs + 1, real, 0.0))
    tl.store(table + 2 * WIDTH, tl.load(first_bias + model * units + k, real, 0.0))
    tl.store(table + 3 * WIDTH, tl.load(bias + model * units + k, real, 0.0))
    tl.store(table + 4 * WIDTH, tl.load(last + k, real, 0.0) / size)
    tl.store(table + 5 * WIDTH, tl.zeros([BLOCK], tl.float32) + size)
