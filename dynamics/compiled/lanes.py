"""A small network on many inputs at once, for numba: rows are units, columns are inputs (lanes).

Every innermost loop runs over ``TILE`` lanes that lie side by side, so that the compiler turns it
into vector instructions; four outputs and four inputs of a layer are taken together, so that what
is loaded is used four times. No library is called, and so none can throttle itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.core.compiler import Compiler
from numpy.typing import NDArray

from dynamics.mlp import MLP, SILU, SOFTPLUS, TANH

TILE = 128
BLOCK = 4
ACTIVATIONS = {TANH: 0, SOFTPLUS: 1, SILU: 2}
_TANH, _SOFTPLUS = 0, 1
_LN2_HIGH, _LN2_LOW = 0.693359375, -2.1219444005469057e-4
Array = NDArray[Any]


class _Apart(Compiler):
    """Promises that the arrays of a call lie apart.

    Without that no table can be looked up in a loop that also writes: each entry might be what
    was just written.
    """

    def define_pipelines(self) -> Any:
        self.state.flags.noalias = True
        return super().define_pipelines()


# Fused multiply-adds are allowed; infinities and NaN stay what they are.
_FAST: dict[str, Any] = {"fastmath": {"contract", "nsz"}, "error_model": "numpy", "cache": True}
kernel = njit(nogil=True, pipeline_class=_Apart, **_FAST)
inlined = njit(forceinline=True, **_FAST)


class Weights(NamedTuple):
    """A network's weights as the kernels take them; padding to ``BLOCK`` is zero and idle.

    Args:
        first: ``(units, inputs)``.
        middle: the square layers, ``(layers, units, units)``.
        last: ``(outputs, units)``.
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


def weights_of(network: MLP, dtype: Any) -> Weights:
    """The weights of a network whose hidden layers are of one width."""
    matrices, biases = [], []
    for layer in network.layers:
        weight, bias = (x.detach().cpu().numpy().astype(dtype) for x in layer.parameters())
        out, into = (-size % BLOCK for size in weight.shape)
        matrices.append(np.pad(weight, ((0, out), (0, into))))
        biases.append(np.pad(bias, (0, out)))
    first, *middle, last = matrices
    *hidden, last_bias = biases
    activation = ACTIVATIONS[network.activation]
    return Weights(first, np.stack(middle), last, np.stack(hidden), last_bias, activation)


class Transposed(NamedTuple):
    """The same layers the other way round, for gradients; ``zeros`` is no bias, ``(units,)``."""

    first: Array
    middle: Array
    zeros: Array


def transposed(weights: Weights) -> Transposed:
    """The layers of a network, the other way round."""
    first, middle = (np.ascontiguousarray(x.swapaxes(-1, -2)) for x in weights[:2])
    return Transposed(first, middle, np.zeros_like(weights.biases[0]))


@inlined
def aligned(size: int, like: Array) -> Array:
    """``(size,)`` uninitialised numbers from the beginning of a cache line on."""
    raw = np.empty(size + 16, like.dtype)
    skip = (-raw.ctypes.data % 64) // raw.itemsize
    return raw[skip : skip + size]


@kernel
def product(matrix: Array, bias: Array, inputs: Array, outputs: Array) -> None:
    """``matrix @ inputs + bias`` on ``TILE`` lanes, ``(inputs * TILE,) -> (outputs * TILE,)``."""
    # Shaped here, where the length of a row is a constant that the compiler sees.
    x, out = inputs.reshape((-1, TILE)), outputs.reshape((-1, TILE))
    for k in range(0, matrix.shape[0], 4):
        for lane in range(TILE):
            out[k, lane], out[k + 1, lane] = bias[k], bias[k + 1]
            out[k + 2, lane], out[k + 3, lane] = bias[k + 2], bias[k + 3]
        for j in range(0, matrix.shape[1], 4):
            a0, a1, a2, a3 = matrix[k, j], matrix[k, j + 1], matrix[k, j + 2], matrix[k, j + 3]
            i = k + 1
            b0, b1, b2, b3 = matrix[i, j], matrix[i, j + 1], matrix[i, j + 2], matrix[i, j + 3]
            i = k + 2
            c0, c1, c2, c3 = matrix[i, j], matrix[i, j + 1], matrix[i, j + 2], matrix[i, j + 3]
            i = k + 3
            d0, d1, d2, d3 = matrix[i, j], matrix[i, j + 1], matrix[i, j + 2], matrix[i, j + 3]
            for lane in range(TILE):
                x0, x1, x2, x3 = x[j, lane], x[j + 1, lane], x[j + 2, lane], x[j + 3, lane]
                # Nested, because a sum of products first would cost an addition more.
                out[k, lane] = a3 * x3 + (a2 * x2 + (a1 * x1 + (a0 * x0 + out[k, lane])))
                out[k + 1, lane] = b3 * x3 + (b2 * x2 + (b1 * x1 + (b0 * x0 + out[k + 1, lane])))
                out[k + 2, lane] = c3 * x3 + (c2 * x2 + (c1 * x1 + (c0 * x0 + out[k + 2, lane])))
                out[k + 3, lane] = d3 * x3 + (d2 * x2 + (d1 * x1 + (d0 * x0 + out[k + 3, lane])))


_TAYLOR = tuple(1.0 / float(np.prod(np.arange(1.0, n + 1))) for n in range(1, 14))


@inlined
def tanh(x: Any, kind: Array) -> Any:
    """Tanh by exp(2|x|) - 1 = 2^n (exp(r) - 1) + (2^n - 1), to a rounding or two of the type.

    Args:
        x: the argument.
        kind: any array of the floating type.
    """
    one, two = kind.dtype.type(1), kind.dtype.type(2)
    y = two * abs(x)
    y = kind.dtype.type(44) if y > kind.dtype.type(44) else y
    n = np.rint(y * kind.dtype.type(1.4426950408889634))
    r = y - n * kind.dtype.type(_LN2_HIGH) - n * kind.dtype.type(_LN2_LOW)
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
    power = kind.dtype.type(np.int64(1) << np.int64(n))
    grown = power * tail + (power - one)
    t = grown / (grown + two)
    return -t if x < kind.dtype.type(0) else t


@kernel
def activate(flat: Array, flat_slopes: Array, activation: int) -> None:
    """Each value ``(units * TILE,)`` by the activation, in place, and the activation's slope."""
    values, slopes = flat.reshape((-1, TILE)), flat_slopes.reshape((-1, TILE))
    one, half = values.dtype.type(1), values.dtype.type(0.5)
    for k in range(values.shape[0]):
        if activation == _TANH:
            for lane in range(TILE):
                t = tanh(values[k, lane], values)
                values[k, lane] = t
                slopes[k, lane] = one - t * t
        elif activation == _SOFTPLUS:
            for lane in range(TILE):
                x = values[k, lane]
                slopes[k, lane] = half + half * tanh(half * x, values)
                large = x if x > values.dtype.type(0) else values.dtype.type(0)
                values[k, lane] = large + values.dtype.type(np.log1p(np.exp(-abs(x))))
        else:
            for lane in range(TILE):
                x = values[k, lane]
                gate = half + half * tanh(half * x, values)
                values[k, lane] = x * gate
                slopes[k, lane] = gate * (one + x * (one - gate))


@kernel
def hidden(weights: Weights, inputs: Array, work: Array) -> None:
    """The hidden layers on ``TILE`` lanes.

    Args:
        weights: see :class:`Weights`.
        inputs: ``(inputs * TILE,)``.
        work: ``(2 * hidden layers, units * TILE)``; afterwards each layer's values in the first
            half, and the activation's slopes in the second.
    """
    layers = weights.biases.shape[0]
    product(weights.first, weights.biases[0], inputs, work[0])
    activate(work[0], work[layers], weights.activation)
    for layer in range(1, layers):
        product(weights.middle[layer - 1], weights.biases[layer], work[layer - 1], work[layer])
        activate(work[layer], work[layers + layer], weights.activation)


@kernel
def input_gradient(
    weights: Weights, back: Transposed, inputs: Array, work: Array, result: Array
) -> None:
    """Gradient of the first output with respect to the inputs, on ``TILE`` lanes.

    Args:
        weights, inputs, work: see :func:`hidden`.
        back: see :class:`Transposed`.
        result: ``(inputs * TILE,)``.
    """
    hidden(weights, inputs, work)
    layers = weights.biases.shape[0]
    for k in range(weights.last.shape[1]):
        for lane in range(k * TILE, (k + 1) * TILE):
            work[layers - 1, lane] = weights.last[0, k] * work[2 * layers - 1, lane]
    for layer in range(layers - 2, -1, -1):
        product(back.middle[layer], back.zeros, work[layer + 1], work[layer])
        for i in range(work.shape[1]):
            work[layer, i] *= work[layers + layer, i]
    product(back.first, back.zeros, work[0], result)
