"""All steps of a block of episodes, ``LANES`` of them side by side, for numba.

The episodes lie innermost, so that the compiler turns every loop into vector instructions; a
block's state never leaves the first-level cache, and each stored state is written once.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.compiled.lanes import TILE, Array
from dynamics.compiled.pairs import (
    ALONG,
    GX,
    LANES,
    RADIAL,
    SPLINE,
    PairFunction,
    Room,
    S,
    X,
    Y,
    ask_networks,
    plane_spline,
    radial_spline,
)
from dynamics.potentials import CORE
from loops.kernels import part, uncounted
from loops.streams import CACHED, streaming

stream = streaming(TILE)


@part
def move_all(q: Array, p: Array, force: Array, mobility: Array, half: Any, dt: Any) -> None:
    """Half a kick and a drift of all coordinates; the forces begin anew."""
    for i in range(p.shape[0]):
        kicked = p[i] + half * force[i]
        p[i] = kicked
        q[i] += dt * kicked * mobility[i]
        force[i] = 0


@part
def _apart(q: Array, i: int, j: int, box: Any, work: Array, pair: int) -> None:
    """Displacement of two bodies, of ``(bodies, 2, LANES)``, in a box to the nearest image."""
    if box > 0:
        for axis in range(2):
            for lane in range(LANES):
                apart = q[i, axis, lane] - q[j, axis, lane]
                work[pair, axis, lane] = apart - box * np.rint(apart / box)
    else:
        for axis in range(2):
            for lane in range(LANES):
                work[pair, axis, lane] = q[i, axis, lane] - q[j, axis, lane]


@part
def _measured(work: Array, pair: int, far: Any, seen: Array) -> Any:
    """The square of a pair's soft length.

    Args:
        work, pair: see :func:`radial_spline`.
        far: square of the soft length up to which a spline reaches.
        seen: the largest and the smallest squared distance so far, ``(2, LANES)``.

    Returns:
        Whether a lane is out of reach.
    """
    core, out = work.dtype.type(CORE * CORE), False
    for lane in range(LANES):
        x, y = work[pair, X, lane], work[pair, Y, lane]
        squared = x * x + y * y
        seen[0, lane] = squared if squared > seen[0, lane] else seen[0, lane]
        seen[1, lane] = squared if squared < seen[1, lane] else seen[1, lane]
        work[pair, S, lane] = squared + core
        out |= not squared + core <= far
    return out


@part
def _pull(kind: int, force: Array, i: int, j: int, weight: Array, work: Array, pair: int) -> None:
    """Add a pair's force to those of its bodies, of ``(bodies, 2, LANES)``."""
    for axis in range(2):
        if kind & RADIAL:
            for lane in range(LANES):
                pull = weight[pair, lane] * work[pair, ALONG, lane] * work[pair, axis, lane]
                force[i, axis, lane] -= pull
                force[j, axis, lane] += pull
        else:
            for lane in range(LANES):
                pull = weight[pair, lane] * work[pair, GX + axis, lane]
                force[i, axis, lane] -= pull
                force[j, axis, lane] += pull


@part
def kick(p: Array, force: Array, half: Any) -> None:
    """Half a kick of all coordinates."""
    for i in range(p.shape[0]):
        p[i] += half * force[i]


@part
def store(q: Array, p: Array, begin: int, count: int, out: Array, index: int) -> None:
    """The first ``count`` lanes into a state of ``(stored, 2, bodies, 2, episodes)``."""
    for i in range(q.shape[0]):
        for axis in range(2):
            for lane in range(count):
                at = np.uint64(begin + lane)  # not negative: else each is asked, one by one
                out[index, 0, i, axis, at] = q[i, axis, lane]
                out[index, 1, i, axis, at] = p[i, axis, lane]


@part
def _stream(q: Array, p: Array, begin: int, out: Array, index: int) -> None:
    """:func:`store` of ``LANES`` episodes, past the caches."""
    rows, episodes = q.shape[0] * 2, out.shape[4]
    first = index * 2 * rows * episodes + begin
    for row in range(rows):
        stream(q, row * LANES, out, first + row * episodes)
        stream(p, row * LANES, out, first + (rows + row) * episodes)


@part
def sum_of(q: Array, p: Array) -> Any:
    """Of all coordinates: finite where they are; what is not finite has stayed so."""
    total = 0.0
    for i in range(q.shape[0]):
        total += q[i] + p[i]
    return total


@uncounted
def steps(
    law: PairFunction,
    block: tuple[Array, Array, Array, Array],
    shaped: tuple[Array, Array, Array],
    weight: Array,
    work: Array,
    room: Room,
    dts: Array,
    box: Any,
    every: int,
    out: Array,
    begin: int,
    count: int,
    seen: Array,
) -> int:
    """Leapfrog steps (kick, drift, kick) of a block.

    Args:
        law: of each pair.
        block: q, p, the force and 1 / m of all coordinates, flat.
        shaped: q, p and the force again, ``(bodies, 2, LANES)``.
        weight: c(G) s_i s_j, ``(pairs, LANES)``.
        work: ``(pairs, ROWS, LANES)``.
        room: for the network.
        dts: seconds of the parts of a step, in their order.
        box: side of a periodic box, or 0.
        every: steps between stored states.
        out: ``(stored, 2, bodies, 2, episodes)``; the first of them is the start.
        begin, count: the block's episodes.
        seen: see :func:`_measured`.

    Returns:
        Pairs at which a spline's network was asked.
    """
    q, p, force, loose = block
    of_q, of_p, of_force = shaped
    bodies, asked, parts = of_q.shape[0], 0, dts.shape[0]
    kind, reach = law.kind, law.reach
    far = reach[0] * reach[0]
    large = out.nbytes > CACHED and count == LANES and out.shape[4] % LANES == 0
    # Before the first step comes one of no length, which finds the first force.
    for move in range((out.shape[0] - 1) * every * parts + 1):
        dt = dts[(move - 1) % parts] if move > 0 else reach.dtype.type(0)
        half = dt * reach.dtype.type(0.5)
        move_all(q, p, force, loose, half, dt)
        pair, out_of_reach = 0, False
        for i in range(bodies):
            for j in range(i + 1, bodies):
                _apart(of_q, i, j, box, work, pair)
                out_of_reach |= _measured(work, pair, far, seen)
                if kind == RADIAL + SPLINE:
                    radial_spline(law.resolution, law.table, work, pair)
                elif kind == SPLINE:
                    plane_spline(law.resolution, far, law.table, work, pair)
                pair += 1
        if out_of_reach:
            asked += ask_networks(law, far, work, count, room)
        pair = 0
        for i in range(bodies):
            for j in range(i + 1, bodies):
                _pull(kind, of_force, i, j, weight, work, pair)
                pair += 1
        kick(p, force, half)
        if move % (every * parts) == 0:
            stored = move // (every * parts)
            if large:
                _stream(of_q, of_p, begin, out, stored)
            else:
                store(of_q, of_p, begin, count, out, stored)
    return asked
