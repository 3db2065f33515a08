"""Gradients of pair functions on lanes, for numba: splines, and the networks behind them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled.lanes import PART, TILE, Array, Transposed, Weights, input_gradient
from dynamics.compiled.octaves import coarse_polynomials, fine_polynomials
from dynamics.compiled.spline import DEGREE
from dynamics.potentials import REACH, SPREAD, RadialPotential
from loops.kernels import inlined, part, uncounted

LANES = TILE  # episodes side by side: a pair of each is one tile of the network
# Rows of a pair's work: displacement, gradient, square of the soft length; of a radial law, the
# gradient is a number times the displacement.
X, Y, GX, GY, S, ROWS = range(6)
ALONG = GX
RADIAL, SPLINE = 1, 2  # flags of a pair function's kind
NEAR, WIDE = RadialPotential.NEAR, RadialPotential.FAR
POWERS = np.uint32(DEGREE + 1)
Room = tuple[Array, Array, Array, Array]  # a network's inputs, sums, hidden layers and gradient


class PairFunction(NamedTuple):
    """A pair function as the loops take it.

    Args:
        kind: sum of ``RADIAL`` and ``SPLINE``, where it is that.
        resolution, table: of the spline; flat.
        reach: soft distance up to which it is used, ``(1,)``; 0 without one.
        weights, back: of the network.
    """

    kind: int
    resolution: int
    reach: Array
    table: Array
    weights: Weights
    back: Transposed


@part
def radial_spline(fineness: int, table: Array, work: Array, pair: int) -> None:
    """Force along the line of a :class:`dynamics.compiled.spline.RadialSpline` at a pair's lanes.

    Args:
        fineness: of the spline.
        table: flat.
        work, pair: ``(pairs, ROWS, LANES)``, and which of them.
    """
    if fineness == 0:
        coarse_polynomials(fineness, table, work, pair * ROWS + S, pair * ROWS + ALONG)
    else:
        fine_polynomials(fineness, table, work, pair * ROWS + S, pair * ROWS + ALONG)


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


@uncounted
def plane_spline(cells: int, far: Any, table: Array, work: Array, pair: int) -> None:
    """Gradient of a :class:`dynamics.compiled.spline.PlaneSpline` at a pair's lanes.

    Args:
        cells: along a side of the square.
        far: square of the soft length up to which it is used; beyond, any cell is.
        table, work, pair: see :func:`radial_spline`.
    """
    zero, one = work.dtype.type(0), work.dtype.type(1)
    spread = work.dtype.type(REACH)
    half, side = work.dtype.type(cells / 2), np.int32(cells // 2)
    for lane in range(LANES):
        x, y = work[pair, X, lane], work[pair, Y, lane]
        length = work[pair, S, lane]
        r = np.sqrt(length)
        shrink = one / (spread + r)
        u, v = x * shrink, y * shrink
        sign = -half if v < zero else half
        left, low = np.floor(u * sign), np.floor(v * sign)
        s, t = u * sign - left, v * sign - low
        inside = length <= far
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
        work[pair, GX, lane] = gu * shrink - x * inward
        work[pair, GY, lane] = gv * shrink - y * inward


@uncounted
def _repeat(result: Array, lanes: int) -> None:
    """Lanes of no episode are copies of the first: so they stay, of a gradient ``(2 * LANES,)``."""
    for row in range(0, 2 * LANES, LANES):
        for lane in range(lanes, LANES):
            result[row + lane] = result[row + lane - lanes]


@uncounted
def _plane_network(law: PairFunction, far: Any, work: Array, room: Room, lanes: int) -> None:
    """Gradient of a :class:`dynamics.potentials.DisplacementPotential` where it is out of reach."""
    inputs, sums, scratch, result = room
    zero, one, half = work.dtype.type(0), work.dtype.type(1), work.dtype.type(0.5 * SPREAD)
    spread = work.dtype.type(REACH)
    for side in range(2):
        sign = half if side == 0 else -half
        for lane in range(LANES):
            x, y = work[X, lane], work[Y, lane]
            scale = (sign + sign) / (spread + np.sqrt(work[S, lane]))
            inputs[lane], inputs[LANES + lane] = scale * x, scale * y
        input_gradient(law.weights, law.back, inputs, sums, scratch, result, lanes)
        _repeat(result, lanes)
        for lane in range(LANES):
            x, y = work[X, lane], work[Y, lane]
            r = np.sqrt(work[S, lane])
            shrink = one / (spread + r)
            gu, gv = sign * result[lane], sign * result[LANES + lane]
            inward = (x * gu + y * gv) * shrink * shrink / r
            if not work[S, lane] <= far:
                # Chosen, not multiplied by nothing: what lies there at first may be no number.
                before_x = work[GX, lane] if side == 1 else zero
                before_y = work[GY, lane] if side == 1 else zero
                work[GX, lane] = before_x + gu * shrink - x * inward
                work[GY, lane] = before_y + gv * shrink - y * inward


@uncounted
def _radial_network(law: PairFunction, far: Any, work: Array, room: Room, lanes: int) -> None:
    """Force along the line of a :class:`dynamics.potentials.RadialPotential`, out of reach."""
    inputs, sums, scratch, result = room
    one, two = work.dtype.type(1), work.dtype.type(2)
    spread = work.dtype.type(SPREAD)
    near, wide = work.dtype.type(NEAR), work.dtype.type(WIDE)
    for lane in range(LANES):
        r = np.sqrt(work[S, lane])
        inputs[lane] = spread * (two * (r / (near + r)) - one)
        inputs[LANES + lane] = spread * (two * (r / (wide + r)) - one)
    input_gradient(law.weights, law.back, inputs, sums, scratch, result, lanes)
    _repeat(result, lanes)
    for lane in range(LANES):
        r = np.sqrt(work[S, lane])
        a, b = one / (near + r), one / (wide + r)
        slope = result[lane] * near * a * a + result[LANES + lane] * wide * b * b
        if not work[S, lane] <= far:
            work[ALONG, lane] = two * spread * slope / r


@uncounted
def ask_networks(law: PairFunction, far: Any, work: Array, count: int, room: Room) -> int:
    """Gradients by the network of the pairs whose spline does not reach, or of all without one.

    Returns:
        Pairs of the first ``count`` lanes that were out of a spline's reach.
    """
    asked, lanes = 0, -(-count // PART) * PART
    for pair in range(work.shape[0]):
        out = 0
        for lane in range(count):
            out += int(not work[pair, S, lane] <= far)
        if out > 0:
            here = work[pair]
            if law.kind & RADIAL:
                _radial_network(law, far, here, room, lanes)
            else:
                _plane_network(law, far, here, room, lanes)
        if law.kind & SPLINE:
            asked += out
    return asked
