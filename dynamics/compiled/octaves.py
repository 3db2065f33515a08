"""Polynomials of which there are a few in each octave, on lanes, for numba.

A float's exponent names its octave, and its mantissa the place in it. With one polynomial an
octave, one coefficient of all of them fits into two vector registers (four of doubles). Where the
processor can pick from two registers at once (AVX-512), that is how coefficients are looked up: in
a cycle, where loads need one for each lane.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numpy.typing import NDArray

from dynamics.compiled.lanes import TILE
from dynamics.compiled.spline import MANTISSA, OCTAVE_DEGREE, OCTAVES
from loops.kernels import instructions, uncounted

AT_ONCE = 4  # registers, which hide each other's latency
REGISTER = 512  # bits
PICK = {32: "llvm.x86.avx512.vpermi2var.ps.512", 64: "llvm.x86.avx512.vpermi2var.pd.512"}
CONTRACT = ("contract",)
Array = NDArray[Any]
LookUp = Callable[[Any, Any], Any]  # of entries of a table by their numbers, both in lanes


def _plainly(fineness: int, table: Array, rows: Array, places: int, values: int) -> None:
    """The polynomials on a row of lanes, in numpy: what numba runs where it does not compile.

    Args:
        fineness, table: see :class:`dynamics.compiled.spline.RadialSpline`; flat.
        rows: of ``TILE`` lanes, in an array of any shape.
        places: the row of places, which are positive.
        values: the row that is written.
    """
    lanes, size = rows.reshape(-1, TILE), rows.itemsize
    at = lanes[places]
    bits = at.view({4: np.int32, 8: np.int64}[size]) >> (MANTISSA[size] - fineness)
    t = np.frexp(at)[0] * 2 ** (fineness + 1) % 1 - 0.5
    coefficients = table.reshape(OCTAVE_DEGREE + 1, -1)
    terms = coefficients[:, bits % coefficients.shape[1]]
    lanes[values] = np.polynomial.polynomial.polyval(t, terms, tensor=False)


def _written(coarse: bool) -> Callable[..., Any]:
    """The instructions for one polynomial an octave, or for any fineness."""

    def written(
        typing: Any, fineness: Any, table: Any, rows: Any, places: Any, values: Any
    ) -> tuple[Any, Callable[..., Any]]:
        def emit(context: Any, build: Any, signature: Any, args: Any) -> Any:
            lanes = _Lanes(build, context.get_data_type(table.dtype))
            quick = coarse and "+avx512f" in context.codegen().magic_tuple()[2]
            fine = context.cast(build, args[0], fineness, types.intp)
            fine = ir.IntType(64)(0) if coarse else fine
            look_up = lanes.picked if quick else lanes.loaded
            return _evaluate(context, lanes, signature.args, args, fine, look_up)

        return types.void(fineness, table, rows, places, values), emit

    return written


def _evaluate(
    context: Any, lanes: _Lanes, kinds: Any, args: Any, fineness: Any, look_up: LookUp
) -> Any:
    """Horner's rule on ``AT_ONCE`` registers, and on the next."""
    build, whole = lanes.build, fineness.type
    table, rows = (context.make_array(kinds[i])(context, build, args[i]) for i in (1, 2))
    from_row, to_row = (
        build.mul(context.cast(build, args[i], kinds[i], types.intp), whole(TILE)) for i in (3, 4)
    )
    pieces = build.shl(whole(OCTAVES), fineness)
    # How many is known, but the compiler must not know: it would hold all coefficients in
    # registers, of which there are too few.
    powers = build.udiv(table.nitems, pieces)
    for first in range(0, TILE, AT_ONCE * lanes.width):
        where = [whole(first + i * lanes.width) for i in range(AT_ONCE)]
        places = [lanes.load(rows.data, build.add(from_row, at)) for at in where]
        found = [lanes.place(x, fineness) for x in places]
        sums = [cgutils.alloca_once(build, lanes.reals) for _ in where]
        for total in sums:
            build.store(lanes.all(0.0), total)
        with cgutils.for_range(build, powers) as loop:
            power = build.sub(build.sub(powers, whole(1)), loop.index)
            entries = build.gep(table.data, [build.mul(power, pieces)])
            for total, (piece, t) in zip(sums, found, strict=True):
                grown = build.fmul(build.load(total), t, flags=CONTRACT)
                build.store(build.fadd(grown, look_up(entries, piece), flags=CONTRACT), total)
        for total, at in zip(sums, where, strict=True):
            lanes.store(build.load(total), rows.data, build.add(to_row, at))
    return context.get_dummy_value()


class _Lanes:
    """Instructions on a register of floats."""

    def __init__(self, build: ir.IRBuilder, real: Any) -> None:
        self.build = build
        self.size = 32 if isinstance(real, ir.FloatType) else 64
        self.width = REGISTER // self.size
        self.reals = ir.VectorType(real, self.width)
        self.whole = ir.IntType(self.size)
        self.wholes = ir.VectorType(self.whole, self.width)

    def all(self, value: float) -> Any:
        """The same float in all lanes."""
        return ir.Constant(self.reals, [value] * self.width)

    def bits(self, value: int) -> Any:
        """The same integer in all lanes."""
        return ir.Constant(self.wholes, [value] * self.width)

    def spread(self, value: Any) -> Any:
        """The same integer, which is not known yet, in all lanes."""
        build, none = self.build, ir.Constant(self.wholes, ir.Undefined)
        short = build.trunc(value, self.whole) if self.size < 64 else value
        one = build.insert_element(none, short, ir.IntType(32)(0))
        return build.shuffle_vector(one, none, ir.VectorType(ir.IntType(32), self.width)(None))

    def _pointer(self, array: Any, at: Any) -> Any:
        return self.build.bitcast(self.build.gep(array, [at]), self.reals.as_pointer())

    def load(self, array: Any, at: Any) -> Any:
        """``array[at : at + width]``."""
        return self.build.load(self._pointer(array, at), align=self.size // 8)

    def store(self, value: Any, array: Any, at: Any) -> None:
        """Into ``array[at : at + width]``."""
        self.build.store(value, self._pointer(array, at), align=self.size // 8)

    def place(self, x: Any, fineness: Any) -> tuple[Any, Any]:
        """The piece that each float lies in, and where in it, from -1/2 to 1/2."""
        build, fine = self.build, self.spread(fineness)
        mantissa = MANTISSA[self.size // 8]
        bits = build.bitcast(x, self.wholes)
        named = build.lshr(bits, build.sub(self.bits(mantissa), fine))
        last = build.sub(build.shl(self.bits(OCTAVES), fine), self.bits(1))
        one = ((1 << (self.size - 2 - mantissa)) - 1) << mantissa  # the bits of 1.0
        below = build.and_(build.shl(bits, fine), self.bits((1 << mantissa) - 1))
        inside = build.bitcast(build.or_(below, self.bits(one)), self.reals)
        return build.and_(named, last), build.fsub(inside, self.all(1.5))

    def picked(self, entries: Any, index: Any) -> Any:
        """``entries[index]`` of ``OCTAVES``: picked from two registers, and from what is picked."""
        build, whole = self.build, ir.IntType(64)
        banks = [self.load(entries, whole(start)) for start in range(0, OCTAVES, self.width)]
        kind = ir.FunctionType(self.reals, [self.reals, self.wholes, self.reals])
        pick = cgutils.get_or_insert_function(build.module, kind, PICK[self.size])
        pairs = zip(banks[::2], banks[1::2], strict=True)
        low, *high = (build.call(pick, [left, index, right]) for left, right in pairs)
        if not high:
            return low
        upper = build.and_(index, self.bits(2 * self.width))
        return build.select(build.icmp_unsigned("!=", upper, self.bits(0)), high[0], low)

    def loaded(self, entries: Any, index: Any) -> Any:
        """``entries[index]`` by a load for each lane."""
        build, found = self.build, ir.Constant(self.reals, ir.Undefined)
        for i in range(self.width):
            lane = ir.Constant(ir.IntType(32), i)
            at = build.gep(entries, [build.extract_element(index, lane)])
            found = build.insert_element(found, build.load(at), lane)
        return found


coarse_polynomials = instructions(_written(coarse=True), _plainly)
_polynomials = instructions(_written(coarse=False), _plainly)


@uncounted
def fine_polynomials(fineness: int, table: Array, rows: Array, places: int, values: int) -> None:
    """In a function of its own: its many instructions would slow the few of the coarse ones."""
    _polynomials(fineness, table, rows, places, values)
