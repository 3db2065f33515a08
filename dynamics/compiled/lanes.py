"""A small network on many inputs at once, for numba: rows are units, columns are inputs (lanes).

Every innermost loop runs over lanes that lie side by side, so that the compiler turns it into
vector instructions; a product's sums are kept in registers, a block of them at a time. No library
is called, and so none can throttle itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.activations import SILU, SOFTPLUS, TANH
from dynamics.mlp import MLP
from loops.kernels import inlined, kernel

TILE = 64
BLOCK, PART = 8, 32  # outputs and lanes whose sums fit into the registers together
ACTIVATIONS = {TANH: 0, SOFTPLUS: 1, SILU: 2}
_TANH, _SOFTPLUS = 0, 1
_LN2_HIGH, _LN2_LOW = 0.693359375, -2.1219444005469057e-4
Array = NDArray[Any]


class Weights(NamedTuple):
    """A network's weights as the kernels take them; padding to ``BLOCK`` is zero and idle.

    Matrices lie in blocks of outputs, ``(blocks, inputs, BLOCK)``, in the order in which
    :func:`product` reads them.

    Args:
        first: of the first layer.
        middle: the square layers, ``(layers, ...)``.
        last: as it is, ``(outputs, units)``.
        biases: of all layers but the last, ``(layers + 1, units)``.
        last_bias: ``(outputs,)``.
        activation: of ``ACTIVATIONS``.
    """

    first: Array
    middle: Array
    last: Array
    biases: Array
    last_bias: Array
    activation: int


class Transposed(NamedTuple):
    """The layers the other way round, for gradients, the last of them times the output's weights.

    Args:
        first: in blocks, its outputs are the inputs.
        middle: in blocks, ``(layers, ...)``.
        zeros: no bias, ``(units,)``.
    """

    first: Array
    middle: Array
    zeros: Array


def weights_of(network: MLP, dtype: Any) -> Weights:
    """The weights of a network whose hidden layers are of one width."""
    (first, *middle, last), (*hidden, last_bias) = _padded(network, dtype)
    activation = ACTIVATIONS[network.activation]
    return Weights(
        blocks_of(first), _stacked(middle), last, np.stack(hidden), last_bias, activation
    )


def transposed(network: MLP, dtype: Any) -> Transposed:
    """The layers of such a network the other way round."""
    (first, *middle, last), (bias, *_) = _padded(network, dtype)
    back = [matrix.T for matrix in middle]
    back[-1] = back[-1] * last[0]
    into = np.pad(first.T, ((0, -first.shape[1] % BLOCK), (0, 0)))
    return Transposed(blocks_of(into), _stacked(back), np.zeros_like(bias))


def _padded(network: MLP, dtype: Any) -> tuple[list[Array], list[Array]]:
    """Matrices and biases with as many outputs, and as many hidden inputs, as make whole blocks."""
    matrices: list[Array] = []
    biases: list[Array] = []
    for layer in network.layers:
        weight, bias = (x.detach().cpu().numpy().astype(dtype) for x in layer.parameters())
        out, into = (-size % BLOCK for size in weight.shape)
        matrices.append(np.pad(weight, ((0, out), (0, into if matrices else 0))))
        biases.append(np.pad(bias, (0, out)))
    return matrices, biases


def blocks_of(matrix: Array) -> Array:
    """``(outputs, inputs) -> (blocks, inputs, BLOCK)``."""
    split = matrix.reshape(-1, BLOCK, matrix.shape[1]).transpose(0, 2, 1)
    return np.ascontiguousarray(split)


def _stacked(matrices: list[Array]) -> Array:
    return np.stack([blocks_of(matrix) for matrix in matrices])


@inlined
def aligned(size: int, like: Array) -> Array:
    """``(size,)`` uninitialised numbers from the beginning of a cache line on."""
    raw = np.empty(size + 16, like.dtype)
    skip = (-raw.ctypes.data % 64) // raw.itemsize
    return raw[skip : skip + size]


@kernel
def product(
    matrix: Array, bias: Array, inputs: Array, sums: Array, outputs: Array, lanes: int
) -> None:
    """``matrix @ inputs + bias``, ``(inputs * TILE,) -> (outputs * TILE,)``.

    Args:
        matrix: in blocks, see :class:`Weights`.
        bias: ``(outputs,)``.
        inputs, outputs: rows of lanes.
        sums: ``(BLOCK * PART,)`` of scratch, which the compiler keeps in registers.
        lanes: the first so many of a row are computed, a multiple of ``PART``.
    """
    one = sums.dtype.type(1)  # known when it is compiled: half as many doubles fit
    width = PART if one + sums.dtype.type(1e-10) == one else PART // 2
    for part in range(0, TILE, width):  # a constant: else the sums are not kept in registers
        for k in range(matrix.shape[0] if part < lanes else 0):
            for lane in range(width):
                sums[lane] = bias[k * BLOCK]
                sums[width + lane] = bias[k * BLOCK + 1]
                sums[2 * width + lane] = bias[k * BLOCK + 2]
                sums[3 * width + lane] = bias[k * BLOCK + 3]
                sums[4 * width + lane] = bias[k * BLOCK + 4]
                sums[5 * width + lane] = bias[k * BLOCK + 5]
                sums[6 * width + lane] = bias[k * BLOCK + 6]
                sums[7 * width + lane] = bias[k * BLOCK + 7]
            for j in range(matrix.shape[1]):
                w0, w1, w2, w3 = matrix[k, j, 0], matrix[k, j, 1], matrix[k, j, 2], matrix[k, j, 3]
                w4, w5, w6, w7 = matrix[k, j, 4], matrix[k, j, 5], matrix[k, j, 6], matrix[k, j, 7]
                at = j * TILE + part
                # One loop, written out: so it becomes 16 vectors that stay where they are.
                for lane in range(width):
                    x = inputs[at + lane]
                    sums[lane] += w0 * x
                    sums[width + lane] += w1 * x
                    sums[2 * width + lane] += w2 * x
                    sums[3 * width + lane] += w3 * x
                    sums[4 * width + lane] += w4 * x
                    sums[5 * width + lane] += w5 * x
                    sums[6 * width + lane] += w6 * x
                    sums[7 * width + lane] += w7 * x
            at = k * BLOCK * TILE + part
            for lane in range(width):
                outputs[at + lane] = sums[lane]
                outputs[at + TILE + lane] = sums[width + lane]
                outputs[at + 2 * TILE + lane] = sums[2 * width + lane]
                outputs[at + 3 * TILE + lane] = sums[3 * width + lane]
                outputs[at + 4 * TILE + lane] = sums[4 * width + lane]
                outputs[at + 5 * TILE + lane] = sums[5 * width + lane]
                outputs[at + 6 * TILE + lane] = sums[6 * width + lane]
                outputs[at + 7 * TILE + lane] = sums[7 * width + lane]


_TAYLOR = tuple(1.0 / float(np.prod(np.arange(1.0, n + 1))) for n in range(1, 14))


@inlined
def tanh(x: Any, kind: Array) -> Any:
    """Tanh by exp(2|x|) - 1 = 2^n (exp(r) - 1) + (2^n - 1), to a rounding or two of the type.

    Args:
        x: the argument.
        kind: any array of the floating type.
    """
    one, two = kind.dtype.type(1), kind.dtype.type(2)
    single = one + kind.dtype.type(1e-10) == one  # known when it is compiled
    y, top = two * abs(x), kind.dtype.type(20) if single else kind.dtype.type(44)
    y = top if y > top else y
    n = np.rint(y * kind.dtype.type(1.4426950408889634))
    r = y - n * kind.dtype.type(_LN2_HIGH) - n * kind.dtype.type(_LN2_LOW)
    tail = kind.dtype.type(_TAYLOR[6])
    if not single:
        tail = kind.dtype.type(_TAYLOR[12])
        tail = tail * r + kind.dtype.type(_TAYLOR[11])
        tail = tail * r + kind.dtype.type(_TAYLOR[10])
        tail = tail * r + kind.dtype.type(_TAYLOR[9])
        tail = tail * r + kind.dtype.type(_TAYLOR[8])
        tail = tail * r + kind.dtype.type(_TAYLOR[7])
        tail = tail * r + kind.dtype.type(_TAYLOR[6])
    tail = tail * r + kind.dtype.type(_TAYLOR[5])
    tail = tail * r + kind.dtype.type(_TAYLOR[4])
    tail = tail * r + kind.dtype.type(_TAYLOR[3])
    tail = tail * r + kind.dtype.type(_TAYLOR[2])
    tail = tail * r + kind.dtype.type(_TAYLOR[1])
    tail = tail * r * r + r
    if single:  # the power of two fits into half the bits, which are twice as many at once
        power = kind.dtype.type(np.int32(1) << np.int32(n))
    else:
        power = kind.dtype.type(np.int64(1) << np.int64(n))
    grown = power * tail + (power - one)
    t = grown / (grown + two)
    return -t if x < kind.dtype.type(0) else t


@kernel
def activate(flat: Array, flat_slopes: Array, activation: int, lanes: int) -> None:
    """Each value ``(units * TILE,)`` by the activation, in place, and the activation's slope."""
    values, slopes = flat.reshape((-1, PART)), flat_slopes.reshape((-1, PART))
    one, half = values.dtype.type(1), values.dtype.type(0.5)
    for k in range(values.shape[0]):
        if k * PART % TILE >= lanes:
            continue
        if activation == _TANH:
            for lane in range(PART):
                t = tanh(values[k, lane], values)
                values[k, lane] = t
                slopes[k, lane] = one - t * t
        elif activation == _SOFTPLUS:
            for lane in range(PART):
                x = values[k, lane]
                slopes[k, lane] = half + half * tanh(half * x, values)
                large = x if x > values.dtype.type(0) else values.dtype.type(0)
                values[k, lane] = large + values.dtype.type(np.log1p(np.exp(-abs(x))))
        else:
            for lane in range(PART):
                x = values[k, lane]
                gate = half + half * tanh(half * x, values)
                values[k, lane] = x * gate
                slopes[k, lane] = gate * (one + x * (one - gate))


@kernel
def _scale(flat: Array, flat_slopes: Array, lanes: int) -> None:
    values, slopes = flat.reshape((-1, TILE)), flat_slopes.reshape((-1, TILE))
    for k in range(values.shape[0]):
        for lane in range(lanes):
            values[k, lane] *= slopes[k, lane]


@kernel
def hidden(weights: Weights, inputs: Array, sums: Array, work: Array, lanes: int) -> None:
    """The hidden layers.

    Args:
        weights: see :class:`Weights`.
        inputs: ``(inputs * TILE,)``.
        sums, lanes: see :func:`product`.
        work: each layer's values, written, ``(2 * hidden layers, units * TILE)``, and in the second
            half the activation's slopes.
    """
    layers = weights.biases.shape[0]
    product(weights.first, weights.biases[0], inputs, sums, work[0], lanes)
    activate(work[0], work[layers], weights.activation, lanes)
    for layer in range(1, layers):
        matrix, bias = weights.middle[layer - 1], weights.biases[layer]
        product(matrix, bias, work[layer - 1], sums, work[layer], lanes)
        activate(work[layer], work[layers + layer], weights.activation, lanes)


@kernel
def input_gradient(
    weights: Weights,
    back: Transposed,
    inputs: Array,
    sums: Array,
    work: Array,
    result: Array,
    lanes: int,
) -> None:
    """Gradient of the first output with respect to the inputs.

    Args:
        weights, inputs, sums, work, lanes: see :func:`hidden`.
        back: see :class:`Transposed`.
        result: ``(inputs * TILE,)``, the inputs padded to ``BLOCK``.
    """
    hidden(weights, inputs, sums, work, lanes)
    layers = weights.biases.shape[0]
    for layer in range(layers - 2, -1, -1):
        # What comes from above: at first the last layer's slopes alone, see Transposed.
        above = work[2 * layers - 1] if layer == layers - 2 else work[layer + 1]
        product(back.middle[layer], back.zeros, above, sums, work[layer], lanes)
        _scale(work[layer], work[layers + layer], lanes)
    product(back.first, back.zeros, work[0], sums, result, lanes)
