"""A residual map's steps on tiles of rows, forward and back, for numba: what trains it.

x' = x + scale * network(x, known), a network of silu layers of one width. Rows are taken ``ROWS``
at a time through all steps, see :mod:`dynamics.compiled.panels` for how a layer's values lie.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled.lanes import Array, aligned, tanh
from dynamics.compiled.panels import (
    BLOCK,
    PANEL,
    ROWS,
    enter,
    enter_back,
    in_panels,
    out_of_panels,
    outer,
    times,
)
from loops.kernels import inlined, kernel


class Net(NamedTuple):
    """A network's weights; units are padded to ``PANEL`` with zeros, which stay without effect.

    Args:
        first: ``(inputs, panels, PANEL)``.
        into: the same the other way round, to panels of inputs, ``(1 or more, units, PANEL)``.
        up: the square layers, upwards, ``(layers, panels, units, PANEL)``.
        down: the same the other way round.
        biases: of all hidden layers, ``(layers + 1, panels, PANEL)``.
        last: ``(outputs, panels, PANEL)``.
        out: the same the other way round, to panels of outputs, ``(1 or more, units, PANEL)``.
        last_bias: ``(outputs,)``.
        none: no bias, ``(panels, PANEL)``, of as many panels as units, inputs or outputs have.
    """

    first: Array
    into: Array
    up: Array
    down: Array
    biases: Array
    last: Array
    out: Array
    last_bias: Array
    none: Array


def net_of(matrices: list[Array], biases: list[Array]) -> Net:
    """From weights as torch keeps them, ``(outputs, inputs)``, from the first layer to the last."""
    pad = -len(biases[0]) % PANEL
    first, *square, last = (
        _grown(x, pad * (i < len(biases) - 1), pad * (i > 0)) for i, x in enumerate(matrices)
    )
    into = in_panels(_grown(first, 0, -first.shape[1] % PANEL))
    out = in_panels(_grown(last, -len(last) % PANEL, 0).T)
    most = max(len(first) // PANEL, len(into), len(out))
    return Net(
        np.ascontiguousarray(first.T).reshape(first.shape[1], -1, PANEL),
        into,
        np.stack([in_panels(np.ascontiguousarray(x.T)) for x in square]),
        np.stack([in_panels(x) for x in square]),
        np.stack([_grown(x[None], 0, pad)[0] for x in biases[:-1]]).reshape(
            len(square) + 1, -1, PANEL
        ),
        last.reshape(len(last), -1, PANEL),
        out,
        biases[-1],
        np.zeros((most, PANEL), first.dtype),
    )


def _grown(matrix: Array, rows: int, columns: int) -> Array:
    """With so many more rows and columns of zeros."""
    return np.pad(matrix, ((0, rows), (0, columns))) if rows or columns else matrix


def weights_of(net: Net, units: int) -> tuple[list[Array], list[Array]]:
    """Inverse of :func:`net_of`: matrices and biases, of what lies in one way round."""
    square = [out_of_panels(up).T[:units, :units] for up in net.up]
    first = net.first.reshape(len(net.first), -1)[:, :units].T
    last = net.last.reshape(len(net.last), -1)[:, :units]
    biases = net.biases.reshape(len(net.biases), -1)[:, :units]
    return [first, *square, last], [*biases, net.last_bias]


@inlined
def _gate(x: Any, kind: Array) -> Any:
    """The logistic function; ``kind`` is any array of the floating type."""
    half = kind.dtype.type(0.5)
    return half + half * tanh(half * x, kind)


@kernel
def _silu(before: Array, after: Array) -> None:
    pre, out = before.reshape(-1), after.reshape(-1)
    for i in range(pre.shape[0]):
        out[i] = pre[i] * _gate(pre[i], pre)


@kernel
def _silu_back(before: Array, after: Array, reached: Array, total: Array) -> None:
    """A layer's values again, and what reaches its argument, in place; its bias' is added up."""
    one = before.dtype.type(1)
    for p in range(before.shape[0]):
        for row in range(ROWS):
            for lane in range(PANEL):
                x = before[p, row, lane]
                gate = _gate(x, before)
                found = reached[p, row, lane] * gate * (one + x * (one - gate))
                after[p, row, lane] = x * gate
                reached[p, row, lane] = found
                total[p, lane] += found


@kernel
def forward_rows(
    net: Net, scale: Array, x: Array, every: int, seen: Array, kept: Array, out: Array, tile: int
) -> None:
    """All steps of a tile of rows.

    Args:
        net: see :class:`Net`.
        scale: of each entry of the state, ``(entries,)``.
        x: the state and what else the network is told, ``(ROWS, inputs)``; it is moved on.
        every: steps between stored states.
        seen: what the network saw at each step, written, ``(steps, ROWS, inputs)``.
        kept: its hidden layers but the first, before their activation, written, ``(steps, layers,
            panels, ROWS, PANEL)``, or of one step, where they are not kept.
        out: states, written, ``(stored, tiles, ROWS, entries)``; the first of them is the start.
        tile: which.
    """
    layers, entries = net.biases.shape[0], scale.shape[0]
    sums = aligned(BLOCK * PANEL, x)
    work = aligned(kept[0, 0].size, x).reshape(kept.shape[2:])
    first = aligned(work.size, x).reshape(work.shape)
    found = aligned(net.out.shape[0] * ROWS * PANEL, x).reshape((net.out.shape[0], ROWS, PANEL))
    out[0, tile] = x[:, :entries]
    for step in range((out.shape[0] - 1) * every):
        at = step if kept.shape[0] > 1 else 0
        if seen.shape[0] > step:
            seen[step] = x
        enter(net.first, net.biases[0], x, sums, first)
        _silu(first, work)
        for layer in range(layers - 1):
            times(work, net.up[layer], net.biases[layer + 1], sums, kept[at, layer])
            _silu(kept[at, layer], work)
        times(work, net.out, net.none, sums, found)
        for row in range(ROWS):
            for i in range(entries):
                new = found[i // PANEL, row, i % PANEL] + net.last_bias[i]
                x[row, i] += scale[i] * new
        if (step + 1) % every == 0:
            out[(step + 1) // every, tile] = x[:, :entries]


@kernel
def backward_rows(
    net: Net,
    scale: Array,
    every: int,
    seen: Array,
    kept: Array,
    upstream: Array,
    on_x: Array,
    total: Net,
    tile: int,
) -> None:
    """From a gradient with respect to the stored states to one of the start and the weights.

    Args:
        net, scale, every, seen, kept, tile: see :func:`forward_rows`.
        upstream: shape of its ``out``.
        on_x: written, ``(ROWS, inputs)``.
        total: gradients are added, in the form of the weights (``down`` and ``none`` are not).
    """
    layers, entries = net.biases.shape[0], scale.shape[0]
    sums = aligned(BLOCK * PANEL, on_x)
    reached = aligned(kept[0, 0].size, on_x).reshape(kept.shape[2:])
    above = aligned(kept[0, 0].size, on_x).reshape(kept.shape[2:])
    values = aligned(kept[0, 0].size, on_x).reshape(kept.shape[2:])
    on_out = aligned(ROWS * entries, on_x).reshape((ROWS, entries))
    first = aligned(kept[0, 0].size, on_x).reshape(kept.shape[2:])
    on_in = aligned(net.into.shape[0] * ROWS * PANEL, on_x).reshape(
        (net.into.shape[0], ROWS, PANEL)
    )
    on_x[:] = 0
    for step in range(seen.shape[0] - 1, -1, -1):
        if (step + 1) % every == 0:
            on_x[:, :entries] += upstream[(step + 1) // every, tile]
        for row in range(ROWS):
            for i in range(entries):
                on_out[row, i] = scale[i] * on_x[row, i]
                total.last_bias[i] += on_out[row, i]
        enter(net.last, net.none, on_out, sums, reached)
        _silu_back(kept[step, layers - 2], values, reached, total.biases[layers - 1])
        enter_back(values, on_out, sums, total.last)
        # The first layer is computed again: to write and read it would take longer.
        enter(net.first, net.biases[0], seen[step], sums, first)
        for layer in range(layers - 2, -1, -1):
            before = kept[step, layer - 1] if layer > 0 else first
            times(reached, net.down[layer], net.none, sums, above)
            _silu_back(before, values, above, total.biases[layer])
            outer(values, reached, sums, total.up[layer])
            reached, above = above, reached
        enter_back(reached, seen[step], sums, total.first)
        times(reached, net.into, net.none, sums, on_in)
        for row in range(ROWS):
            for i in range(on_x.shape[1]):
                on_x[row, i] += on_in[i // PANEL, row, i % PANEL]
    on_x[:, :entries] += upstream[0, tile]
