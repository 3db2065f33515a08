"""The input gradient of a network of two hidden tanh layers, and its way back, for numba.

Rows of inputs are taken ``ROWS`` at a time, so that what lies between two products stays in a
core's own cache; see :mod:`dynamics.compiled.panels` for how it lies there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynamics.compiled.lanes import Array, aligned, tanh
from dynamics.compiled.panels import (
    BLOCK,
    PANEL,
    ROWS,
    enter,
    enter_back,
    in_panels,
    leave,
    outer,
    times,
)
from loops.kernels import kernel


class Layers(NamedTuple):
    """A network's weights; units are padded to ``PANEL`` with zeros, which stay without effect.

    Args:
        first: ``(inputs, panels, PANEL)``, and its bias ``first_bias``, ``(panels, PANEL)``.
        up: the square layer, from the first units to the second, ``(panels, units, PANEL)``.
        down: the same the other way round.
        bias: of the square layer.
        last: of the single output, ``(panels, PANEL)``.
        none: no bias.
    """

    first: Array
    first_bias: Array
    up: Array
    down: Array
    bias: Array
    last: Array
    none: Array


def layers(first: Array, first_bias: Array, square: Array, bias: Array, last: Array) -> Layers:
    """From weights as torch keeps them, ``(outputs, inputs)``, of an output's single unit."""
    units, pad = len(bias), -len(bias) % PANEL
    if pad:
        square = np.pad(square, ((0, pad), (0, pad)))
        first, last = np.pad(first, ((0, pad), (0, 0))), np.pad(last, ((0, 0), (0, pad)))
        bias, first_bias = np.pad(bias, (0, pad)), np.pad(first_bias, (0, pad))
    return Layers(
        np.ascontiguousarray(first.T).reshape(-1, (units + pad) // PANEL, PANEL),
        first_bias.reshape(-1, PANEL),
        in_panels(square.T),
        in_panels(square),
        bias.reshape(-1, PANEL),
        last.reshape(-1, PANEL),
        np.zeros((len(bias) // PANEL, PANEL), square.dtype),
    )


@kernel
def _squash(values: Array) -> None:
    for p in range(values.shape[0]):
        for row in range(ROWS):
            for lane in range(PANEL):
                values[p, row, lane] = tanh(values[p, row, lane], values)


@kernel
def _descend(last: Array, top: Array, out: Array) -> None:
    """The last layer's weights times the slopes of the second hidden layer."""
    one = top.dtype.type(1)
    for p in range(top.shape[0]):
        for row in range(0, ROWS, 2):  # two at once: a shorter loop becomes no vector code
            for lane in range(PANEL):
                w, h, g = last[p, lane], top[p, row, lane], top[p, row + 1, lane]
                out[p, row, lane] = w * (one - h * h)
                out[p, row + 1, lane] = w * (one - g * g)


@kernel
def _steepened(values: Array, low: Array, out: Array) -> None:
    """``values`` times tanh's slope, given its output."""
    one = values.dtype.type(1)
    value, h, steep = values.reshape(-1), low.reshape(-1), out.reshape(-1)
    for i in range(value.shape[0]):
        steep[i] = value[i] * (one - h[i] * h[i])


@kernel
def gradient_rows(
    net: Layers, x: Array, top: Array, sent: Array, out: Array, tiles: tuple[int, int]
) -> int:
    """Input gradients of some tiles of rows.

    Args:
        net: see :class:`Layers`.
        x: ``(tiles, ROWS, inputs)``.
        top: the second layer's values, written, ``(tiles, panels, ROWS, PANEL)``, or of one tile,
            where they are not kept.
        sent: what the second hands down to the first, written, likewise.
        out: the gradient, written, shape of ``x``.
        tiles: the first of them, and the one after the last.
    """
    sums = aligned(BLOCK * PANEL, x)
    low = aligned(top[0].size, x).reshape(top.shape[1:])
    work = aligned(top[0].size, x).reshape(top.shape[1:])
    for tile in range(tiles[0], tiles[1]):
        at = tile if top.shape[0] > 1 else 0
        enter(net.first, net.first_bias, x[tile], sums, low)
        _squash(low)
        times(low, net.up, net.bias, sums, top[at])
        _squash(top[at])
        _descend(net.last, top[at], work)
        times(work, net.down, net.none, sums, sent[at])
        _steepened(sent[at], low, work)
        leave(net.first, work, out[tile])
    return 0


@kernel
def value_rows(net: Layers, x: Array, out: Array, tiles: tuple[int, int]) -> int:
    """Outputs of some tiles of rows, without the last layer's bias.

    Args:
        net, x, tiles: see :func:`gradient_rows`.
        out: ``(tiles, ROWS, 1)``.
    """
    panels = net.last.shape[0]
    sums, last = aligned(BLOCK * PANEL, x), net.last.reshape((1, panels, PANEL))
    low = aligned(panels * ROWS * PANEL, x).reshape((panels, ROWS, PANEL))
    top = aligned(panels * ROWS * PANEL, x).reshape((panels, ROWS, PANEL))
    for tile in range(tiles[0], tiles[1]):
        enter(net.first, net.first_bias, x[tile], sums, low)
        _squash(low)
        times(low, net.up, net.bias, sums, top)
        _squash(top)
        leave(last, top, out[tile])
    return 0


@kernel
def _bend_low(low: Array, sent: Array, lifted: Array, steep: Array, bent: Array) -> None:
    """What reaches ``sent``, and what reaches the first layer's values through its slopes."""
    one, two = low.dtype.type(1), low.dtype.type(2)
    for p in range(low.shape[0]):
        for row in range(ROWS):
            for lane in range(PANEL):
                h, d = low[p, row, lane], lifted[p, row, lane]
                steep[p, row, lane] = d * (one - h * h)
                bent[p, row, lane] = -two * h * sent[p, row, lane] * d


@kernel
def _bend_top(
    last: Array, top: Array, reached: Array, pre: Array, on_last: Array, on_bias: Array
) -> None:
    """What reaches the second layer before its tanh; its bias' and the last layer's, added up."""
    one, two = top.dtype.type(1), top.dtype.type(2)
    for p in range(top.shape[0]):
        for row in range(ROWS):
            for lane in range(PANEL):
                h = top[p, row, lane]
                steep = reached[p, row, lane] * (one - h * h)
                bent = -two * h * last[p, lane] * steep
                on_last[p, lane] += steep
                on_bias[p, lane] += bent
                pre[p, row, lane] = bent


@kernel
def _join(low: Array, bent: Array, through: Array, pre: Array, total: Array) -> None:
    """What reaches the first layer before its tanh, by both ways; and its bias, added up."""
    one = low.dtype.type(1)
    for p in range(low.shape[0]):
        for row in range(ROWS):
            for lane in range(PANEL):
                h = low[p, row, lane]
                reached = (bent[p, row, lane] + through[p, row, lane]) * (one - h * h)
                pre[p, row, lane] = reached
                total[p, lane] += reached


@kernel
def backward_rows(
    net: Layers,
    x: Array,
    top: Array,
    sent: Array,
    upstream: Array,
    on_x: Array,
    total: Layers,
    tiles: tuple[int, int],
) -> int:
    """From a gradient with respect to the input gradients to one of rows and weights.

    Args:
        net, x, top, sent, tiles: see :func:`gradient_rows`.
        upstream: shape of ``x``.
        on_x: written, shape of ``x``.
        total: gradients are added, in the form of the weights (``down`` and ``none`` are not).
    """
    sums = aligned(BLOCK * PANEL, x)
    # The first layer is computed again: to write and read it would take longer.
    low = aligned(top[0].size, x).reshape(top.shape[1:])
    a = aligned(low.size, x).reshape(low.shape)
    b = aligned(low.size, x).reshape(low.shape)
    c = aligned(low.size, x).reshape(low.shape)
    d = aligned(low.size, x).reshape(low.shape)
    for tile in range(tiles[0], tiles[1]):
        enter(net.first, net.first_bias, x[tile], sums, low)
        _squash(low)
        enter(net.first, net.none, upstream[tile], sums, a)  # reaches what the first layer gave
        _bend_low(low, sent[tile], a, b, c)  # b reaches sent, c the first layer's values
        times(b, net.up, net.none, sums, a)  # reaches what the second layer gave
        _bend_top(net.last, top[tile], a, d, total.last, total.bias)  # d: the second's argument
        _descend(net.last, top[tile], a)
        outer(b, a, sums, total.up)
        outer(low, d, sums, total.up)
        times(d, net.down, net.none, sums, a)
        _join(low, c, a, b, total.first_bias)  # b reaches the first layer's argument
        enter_back(b, x[tile], sums, total.first)
        leave(net.first, b, on_x[tile])
        _steepened(sent[tile], low, a)
        enter_back(a, upstream[tile], sums, total.first)
    return 0
