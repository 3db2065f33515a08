"""Stores that pass the caches by, for numba.

What is written and not read again soon had better not be fetched from memory first, nor drive out
what lies in the caches: of a rollout that is larger than a second-level cache, that takes longer
than the steps themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types

from dynamics.compiled.kernels import instructions
from dynamics.compiled.lanes import TILE, Array

LINE = 64  # bytes that are written at once, from an address that is a multiple of them


def _plainly(source: Array, begin: int, target: Array, at: int) -> None:
    """``TILE`` numbers of an array into another, both flat, in numpy."""
    target.reshape(-1)[at : at + TILE] = source.reshape(-1)[begin : begin + TILE]


def _by_lines(
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
        for lane in range(0, TILE, width):
            here, there = (
                build.bitcast(build.gep(x, [build.add(i, whole(lane))]), line)
                for x, i in zip(data, first, strict=True)
            )
            # No fence: what hands the states to another thread is a lock, which waits for them.
            written = build.store(build.load(here, align=LINE), there, align=LINE)
            written.set_metadata("nontemporal", by)
        return context.get_dummy_value()

    return types.void(source, begin, target, at), emit


stream = instructions(_by_lines, _plainly)
