"""Gradients of pair functions on lanes, for numba: splines, and the networks behind them."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.compiled.lanes import (
    TILE,
    Array,
    Transposed,
    Weights,
    inlined,
    input_gradient,
    kernel,
)
from dynamics.compiled.spline import DEGREE
from dynamics.potentials import CORE, REACH, SPREAD, RadialPotential

LANES = TILE  # episodes side by side: a pair of each is one tile of the network
X, Y, GX, GY, OUT, S, ROWS = range(7)  # rows of a pair's work: displacement, gradient, out of reach
RADIAL, SPLINE = 1, 2  # flags of a pair function's kind
NEAR, FAR = RadialPotential.NEAR, RadialPotential.FAR
POWERS = np.uint32(DEGREE + 1)


@kernel
def radial_spline(
    cells: int, first: int, reach: Array, table: Array, integers: Array, pair: Array
) -> Any:
    """Gradient of a :class:`dynamics.compiled.spline.RadialSpline` at a pair's lanes.

    Args:
        cells: bits of a number that say nothing of its cell.
        first: the number of the first cell.
        reach: soft distance up to which the spline is used, ``(1,)``.
        table: flat.
        integers: empty, of the integer type that a float's bits are read as.
        pair: its work, ``(ROWS * LANES,)``.

    Returns:
        Lanes that are out of reach.
    """
    work = pair.reshape((ROWS, LANES))
    zero, one = work.dtype.type(0), work.dtype.type(1)
    out = np.int32(0)
    core, far = work.dtype.type(CORE * CORE), reach[0] * reach[0]
    below = (1 << cells) - 1
    scale = one / work.dtype.type(below + 1)
    for lane in range(LANES):
        x, y = work[X, lane], work[Y, lane]
        work[S, lane] = x * x + y * y + core
    bits = work[S].view(integers.dtype)
    for lane in range(LANES):
        inside = work[S, lane] <= far
        t = work.dtype.type(bits[lane] & below) * scale
        cell = np.uint32((bits[lane] >> cells) - first) if inside else np.uint32(0)
        at = cell * np.uint32(4)
        force = table[at + np.uint32(3)]
        force = force * t + table[at + np.uint32(2)]
        force = force * t + table[at + np.uint32(1)]
        force = force * t + table[at]
        work[GX, lane] = force * work[X, lane]
        work[GY, lane] = force * work[Y, lane]
        work[OUT, lane] = zero if inside else one
        out += np.int32(0) if inside else np.int32(1)
    return out


@inlined
def _row(table: Array, at: Any, t: Any) -> tuple[Any, Any]:
    """A polynomial of degree 5 in t and its derivative; written out, or it is no vector code."""
    value = table[at + np.uint32(5)]
    slope = value
    value = value * t + table[at + np.uint32(4)]
    slope = slope * t + value
    value = value * t + table[at + np.uint32(3)]
    slope = slope * t + value
    value = value * t + table[at + np.uint32(2)]
    slope = slope * t + value
    value = value * t + table[at + np.uint32(1)]
    slope = slope * t + value
    return value * t + table[at], slope


@kernel
def plane_spline(cells: int, reach: Array, table: Array, pair: Array) -> Any:
    """Gradient of a :class:`dynamics.compiled.spline.PlaneSpline` at a pair's lanes.

    Args:
        cells: along a side of the square.
        reach, table, pair, result: see :func:`radial_spline`.
    """
    work = pair.reshape((ROWS, LANES))
    zero, one = work.dtype.type(0), work.dtype.type(1)
    out = np.int32(0)
    core, spread = work.dtype.type(CORE * CORE), work.dtype.type(REACH)
    half, side = work.dtype.type(cells / 2), np.int32(cells // 2)
    far = reach[0]
    for lane in range(LANES):
        x, y = work[X, lane], work[Y, lane]
        r = np.sqrt(x * x + y * y + core)
        shrink = one / (spread + r)
        u, v = x * shrink, y * shrink
        sign = -half if v < zero else half
        left, low = np.floor(u * sign), np.floor(v * sign)
        s, t = u * sign - left, v * sign - low
        inside = r <= far
        cell = np.uint32((np.int32(left) + side) * side + np.int32(low)) if inside else np.uint32(0)
        at = cell * (POWERS * POWERS)
        value, across = _row(table, at + np.uint32(5) * POWERS, t)
        along = value
        row, slope = _row(table, at + np.uint32(4) * POWERS, t)
        value, across = value * s + row, across * s + slope
        along = along * s + value
        row, slope = _row(table, at + np.uint32(3) * POWERS, t)
        value, across = value * s + row, across * s + slope
        along = along * s + value
        row, slope = _row(table, at + np.uint32(2) * POWERS, t)
        value, across = value * s + row, across * s + slope
        along = along * s + value
        row, slope = _row(table, at + POWERS, t)
        value, across = value * s + row, across * s + slope
        along = along * s + value
        row, slope = _row(table, at, t)
        across = across * s + slope
        gu, gv = along * sign, across * sign
        inward = (u * gu + v * gv) * shrink / r
        work[GX, lane] = gu * shrink - x * inward
        work[GY, lane] = gv * shrink - y * inward
        work[OUT, lane] = zero if inside else one
        out += np.int32(0) if inside else np.int32(1)
    return out


@kernel
def _plane_network(
    weights: Weights,
    back: Transposed,
    pair: Array,
    inputs: Array,
    sums: Array,
    scratch: Array,
    result: Array,
) -> None:
    """Gradient of a :class:`dynamics.potentials.DisplacementPotential` where OUT is not 0."""
    work = pair.reshape((ROWS, LANES))
    one, half = work.dtype.type(1), work.dtype.type(0.5 * SPREAD)
    core, reach = work.dtype.type(CORE * CORE), work.dtype.type(REACH)
    for side in range(2):
        sign = half if side == 0 else -half
        for lane in range(LANES):
            x, y = work[X, lane], work[Y, lane]
            scale = (sign + sign) / (reach + np.sqrt(x * x + y * y + core))
            inputs[lane], inputs[LANES + lane] = scale * x, scale * y
        input_gradient(weights, back, inputs, sums, scratch, result)
        for lane in range(LANES):
            x, y = work[X, lane], work[Y, lane]
            r = np.sqrt(x * x + y * y + core)
            shrink = one / (reach + r)
            gu, gv = sign * result[lane], sign * result[LANES + lane]
            inward = (x * gu + y * gv) * shrink * shrink / r
            if work[OUT, lane] != 0:
                kept = work.dtype.type(side)
                work[GX, lane] = kept * work[GX, lane] + gu * shrink - x * inward
                work[GY, lane] = kept * work[GY, lane] + gv * shrink - y * inward


@kernel
def _radial_network(
    weights: Weights,
    back: Transposed,
    pair: Array,
    inputs: Array,
    sums: Array,
    scratch: Array,
    result: Array,
) -> None:
    """Gradient of a :class:`dynamics.potentials.RadialPotential` where OUT is not 0."""
    work = pair.reshape((ROWS, LANES))
    one, two = work.dtype.type(1), work.dtype.type(2)
    core, spread = work.dtype.type(CORE * CORE), work.dtype.type(SPREAD)
    near, far = work.dtype.type(NEAR), work.dtype.type(FAR)
    for lane in range(LANES):
        x, y = work[X, lane], work[Y, lane]
        r = np.sqrt(x * x + y * y + core)
        inputs[lane] = spread * (two * (r / (near + r)) - one)
        inputs[LANES + lane] = spread * (two * (r / (far + r)) - one)
    input_gradient(weights, back, inputs, sums, scratch, result)
    for lane in range(LANES):
        x, y = work[X, lane], work[Y, lane]
        r = np.sqrt(x * x + y * y + core)
        a, b = one / (near + r), one / (far + r)
        slope = result[lane] * near * a * a + result[LANES + lane] * far * b * b
        pull = two * spread * slope / r
        if work[OUT, lane] != 0:
            work[GX, lane], work[GY, lane] = pull * x, pull * y


@kernel
def ask_networks(
    kind: int,
    weights: Weights,
    back: Transposed,
    work: Array,
    count: int,
    inputs: Array,
    sums: Array,
    scratch: Array,
    result: Array,
) -> int:
    """Gradients by the network of the pairs whose spline does not reach, or of all without one.

    Returns:
        Pairs of the first ``count`` lanes that were out of a spline's reach.
    """
    asked = 0
    for pair in range(work.shape[0]):
        out = 0
        if kind & SPLINE:
            for lane in range(OUT * LANES, OUT * LANES + count):
                out += int(work[pair, lane] != 0)
        asked += out
        if out > 0 or not kind & SPLINE:
            here = work[pair]
            if kind & RADIAL:
                _radial_network(weights, back, here, inputs, sums, scratch, result)
            else:
                _plane_network(weights, back, here, inputs, sums, scratch, result)
    return asked
