"""Stores that pass the caches by, for numba.

What is written and not read again soon had better not be fetched from memory first, nor drive out
what lies in the caches: of what is larger than a second-level cache, that takes longer than to
compute it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numpy.typing import NDArray

from loops.kernels import instructions

LINE = 64  # bytes that are written at once, from an address that is a multiple of them
CACHED = 2**22  # bytes of a result up to which it is written into the caches


def streaming(numbers: int) -> Any:
    """``stream(source, begin, target, at)``: so many numbers of an array into another, both flat.

    Where they begin in either must be a multiple of ``LINE`` bytes, and so must ``numbers`` be.
    """

    def plainly(source: NDArray[Any], begin: int, target: NDArray[Any], at: int) -> None:
        target.reshape(-1)[at : at + numbers] = source.reshape(-1)[begin : begin + numbers]

    def by_lines(
        typing: Any, source: Any, begin: Any, target: Any, at: Any
    ) -> tuple[Any, Callable[..., Any]]:
        def emit(context: Any, build: Any, signature: Any, args: Any) -> Any:
            kinds = signature.args
            real = context.get_data_type(source.dtype)
            width = LINE // (4 if isinstance(real, ir.FloatType) else 8)
            line, whole = ir.VectorType(real, width).as_pointer(), ir.IntType(64)
            data = [context.make_array(kinds[i])(context, build, args[i]).data for i in (0, 2)]
            first = [context.cast(build, args[i], kinds[i], types.intp) for i in (1, 3)]
            by = build.module.add_metadata([ir.IntType(32)(1)])
            for lane in range(0, numbers, width):
                here, there = (
                    build.bitcast(build.gep(x, [build.add(i, whole(lane))]), line)
                    for x, i in zip(data, first, strict=True)
                )
                # No fence: what hands the result to another thread is a lock, which waits for it.
                written = build.store(build.load(here, align=LINE), there, align=LINE)
                written.set_metadata("nontemporal", by)
            return context.get_dummy_value()

        return types.void(source, begin, target, at), emit

    return instructions(by_lines, plainly)
