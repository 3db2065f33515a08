"""Fused rollouts of an unstructured map on the CPU, by numba: all steps of a block, then the next.

The map's whole state is one column of its network's inputs; episodes lie side by side in lanes, see
:mod:`dynamics.compiled.lanes`. :meth:`dynamics.maps.TransitionMap.advance` is the twin.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from dynamics.compiled.lanes import (
    BLOCK,
    PART,
    TILE,
    Array,
    Weights,
    aligned,
    blocks_of,
    product,
    tanh,
    weights_of,
)
from dynamics.mlp import MLP
from loops.kernels import kernel
from loops.threads import in_threads


@kernel
def _silu(flat: Array, lanes: int) -> None:
    """The activation of a layer's values ``(units * TILE,)``, in place."""
    values = flat.reshape((-1, PART))
    one, half = values.dtype.type(1), values.dtype.type(0.5)
    for k in range(values.shape[0]):
        for lane in range(PART if k * PART % TILE < lanes else 0):
            x = half * values[k, lane]
            values[k, lane] = x * (one + tanh(x, values))


@kernel
def _add(state: Array, step: Array, scale: Array) -> None:
    """``state += scale * step``, as far as there are scales."""
    for i in range(scale.shape[0]):
        state[i] += scale[i] * step[i]


@kernel
def _roll(
    weights: Weights,
    last: Array,
    scale: Array,
    start: Array,
    known: Array,
    every: int,
    out: Array,
    which: tuple[int, int],
) -> int:
    """Steps of some episodes, in blocks.

    Args:
        weights: of the network.
        last: its last layer in blocks.
        scale: of each entry of the state on each lane, ``(entries * TILE,)``.
        start: ``(entries, episodes)``.
        known: what the network is told besides, ``(conditions, episodes)``.
        every: steps between stored states.
        out: ``(stored, entries, episodes)``; the first of them is the start.
        which: the first episode, and the one after the last.
    """
    entries = start.shape[0]
    told, units = entries + known.shape[0], weights.biases.shape[1]
    inputs = aligned(told * TILE, scale)
    result = aligned(last.shape[0] * BLOCK * TILE, scale)
    sums = aligned(BLOCK * PART, scale)
    layers = weights.biases.shape[0]
    work = aligned(layers * units * TILE, scale).reshape((layers, units * TILE))
    result[:] = 0  # what is not in use is added all the same
    for begin in range(which[0], which[1], TILE):
        count = min(TILE, which[1] - begin)
        used = -(-count // PART) * PART
        for lane in range(TILE):
            source = begin + min(lane, count - 1)  # lanes of no episode repeat the last one
            for row in range(entries):
                inputs[row * TILE + lane] = start[row, source]
            for row in range(known.shape[0]):
                inputs[(entries + row) * TILE + lane] = known[row, source]
        for move in range((out.shape[0] - 1) * every + 1):
            if move > 0:
                product(weights.first, weights.biases[0], inputs, sums, work[0], used)
                _silu(work[0], used)
                for layer in range(1, layers):
                    matrix, bias = weights.middle[layer - 1], weights.biases[layer]
                    product(matrix, bias, work[layer - 1], sums, work[layer], used)
                    _silu(work[layer], used)
                product(last, weights.last_bias, work[layers - 1], sums, result, used)
                _add(inputs, result, scale)
            if move % every == 0:
                state = inputs.reshape((-1, TILE))[:entries, :count]
                out[move // every, :, begin : begin + count] = state
    return 0


def roll(
    network: MLP, scale: Tensor, start: Tensor, known: Tensor, stored: int, every: int
) -> Tensor:
    """Steps of x' = x + scale * network(x, known).

    Args:
        network: of silu layers of one width.
        scale: of each entry of the state, ``(entries,)``.
        start: ``(episodes, entries)``.
        known: ``(episodes, conditions)``.
        stored: states that are stored after the start.
        every: steps between them.

    Returns:
        States, ``(stored + 1, entries, episodes)``.
    """
    weights = weights_of(network, start.numpy().dtype)
    first, told = (np.ascontiguousarray(x.numpy().T) for x in (start, known))
    sizes = np.repeat(scale.numpy(), TILE)
    out = np.empty((stored + 1, *first.shape), first.dtype)
    last = blocks_of(weights.last)

    def part(which: tuple[int, int]) -> int:
        some = which[0] * PART, min(which[1] * PART, len(start))
        return _roll(weights, last, sizes, first, told, every, out, some)

    in_threads(part, -(-len(start) // PART))
    return torch.from_numpy(out)
