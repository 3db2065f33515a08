"""Fused rollouts on the CPU, by numba: all steps of a block of episodes before the next block.

``LANES`` episodes are stepped side by side, innermost, so that the compiler turns every loop into
vector instructions; a block's state never leaves the first-level cache, and each stored state is
written once. Blocks run on as many threads as torch has been told to use.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from dynamics.compiled.lanes import (
    BLOCK,
    PART,
    TILE,
    Array,
    Transposed,
    Weights,
    aligned,
    kernel,
    transposed,
    weights_of,
)
from dynamics.compiled.pairs import (
    GX,
    GY,
    LANES,
    RADIAL,
    ROWS,
    SPLINE,
    X,
    Y,
    ask_networks,
    plane_spline,
    radial_spline,
)
from dynamics.compiled.spline import PairSpline
from dynamics.domain import FARTHEST, NEAREST
from dynamics.potentials import DisplacementPotential, RadialPotential

Found = TypeVar("Found")


@kernel
def move_all(q: Array, p: Array, force: Array, mobility: Array, half: Any, dt: Any) -> None:
    """Half a kick and a drift of all coordinates; the forces begin anew."""
    for i in range(p.shape[0]):
        kicked = p[i] + half * force[i]
        p[i] = kicked
        q[i] += dt * kicked * mobility[i]
        force[i] = 0


@kernel
def _apart(here: Array, there: Array, box: Any, pair: Array) -> None:
    """Displacement of two bodies ``(2 * LANES,)``, in a box to the nearest image."""
    for i in range(2 * LANES):
        pair[i] = here[i] - there[i]
    if box > 0:
        for i in range(2 * LANES):
            pair[i] -= box * np.rint(pair[i] / box)


@kernel
def _pull(here: Array, there: Array, weight: Array, pair: Array) -> None:
    """Add a pair's force to those of its bodies, ``(2 * LANES,)``."""
    gradient = pair[GX * LANES : (GY + 1) * LANES]
    for lane in range(LANES):
        pull = weight[lane] * gradient[lane]
        here[lane] -= pull
        there[lane] += pull
    for lane in range(LANES):
        pull = weight[lane] * gradient[LANES + lane]
        here[LANES + lane] -= pull
        there[LANES + lane] += pull


@kernel
def kick(p: Array, force: Array, half: Any) -> None:
    """Half a kick of all coordinates."""
    for i in range(p.shape[0]):
        p[i] += half * force[i]


@kernel
def _store(q: Array, p: Array, begin: int, count: int, out: Array) -> None:
    """The first ``count`` lanes into ``(2, bodies * 2, episodes)``."""
    for row in range(2 * q.shape[0]):
        for lane in range(count):
            at = row % 2 * LANES + lane
            out[0, row, begin + lane] = q[row // 2, at]
            out[1, row, begin + lane] = p[row // 2, at]


@kernel
def _look(p: Array, work: Array, seen: Array) -> None:
    """What is nearer or farther than whatever was seen before, in each lane.

    Args:
        p: of a block of episodes, ``(bodies, 2 * LANES)``.
        work: of its pairs, whose displacements are those of where the bodies are.
        seen: the largest and the smallest squared distance, and a zero that a number that is not
            finite makes NaN, ``(3, LANES)``.
    """
    zero = seen.dtype.type(0)
    for i in range(p.shape[0]):
        for lane in range(LANES):
            seen[2, lane] += zero * (p[i, lane] + p[i, LANES + lane])
    for pair in range(work.shape[0]):
        for lane in range(LANES):
            x, y = work[pair, X * LANES + lane], work[pair, Y * LANES + lane]
            apart = x * x + y * y
            seen[0, lane] = apart if apart > seen[0, lane] else seen[0, lane]
            seen[1, lane] = apart if apart < seen[1, lane] else seen[1, lane]
            seen[2, lane] += zero * apart


@kernel
def _roll(
    kind: int,
    cells: int,
    first: int,
    reach: Array,
    table: Array,
    integers: Array,
    weights: Weights,
    back: Transposed,
    start: Array,
    mobility: Array,
    strength: Array,
    dts: Array,
    box: Any,
    every: int,
    out: Array,
    seen: Array,
    blocks: tuple[int, int],
) -> int:
    """Leapfrog steps (kick, drift, kick) of all episodes.

    Args:
        kind: sum of ``RADIAL`` and ``SPLINE``, where it is that.
        cells, first, reach, table, integers: see :func:`radial_spline`.
        weights, back: of the network.
        start: ``(2, bodies * 2, episodes)``, q and p.
        mobility: 1 / m, ``(bodies, episodes)``.
        strength: c(G) s_i s_j, ``(pairs, episodes)``.
        dts: seconds of the parts of a step, in their order.
        box: side of a periodic box, or 0.
        every: steps between stored states.
        out: ``(stored, 2, bodies * 2, episodes)``; the first of them is the start.
        seen: what the stored states reached, see :func:`_look`.
        blocks: the first block of episodes, and the one after the last.

    Returns:
        Pairs at which a spline's network was asked.
    """
    bodies, pairs, episodes = mobility.shape[0], strength.shape[0], out.shape[3]
    asked, parts = 0, dts.shape[0]
    layers, units = weights.biases.shape
    for block in range(blocks[0], blocks[1]):
        begin = block * LANES
        count = min(LANES, episodes - begin)
        q = aligned(bodies * 2 * LANES, reach).reshape((bodies, 2 * LANES))
        p = aligned(bodies * 2 * LANES, reach).reshape((bodies, 2 * LANES))
        force = aligned(bodies * 2 * LANES, reach).reshape((bodies, 2 * LANES))
        loose = aligned(bodies * 2 * LANES, reach).reshape((bodies, 2 * LANES))
        weight = aligned(pairs * LANES, reach).reshape((pairs, LANES))
        work = aligned(pairs * ROWS * LANES, reach).reshape((pairs, ROWS * LANES))
        inputs, result = aligned(BLOCK * TILE, reach), aligned(BLOCK * TILE, reach)
        sums = aligned(BLOCK * PART, reach)
        scratch = aligned(2 * layers * units * TILE, reach).reshape((2 * layers, units * TILE))
        inputs[:] = 0
        force[:] = 0
        work[:] = 1
        for lane in range(LANES):
            source = begin + min(lane, count - 1)  # lanes of no episode repeat the last one
            for row in range(2 * bodies):
                at = row % 2 * LANES + lane
                q[row // 2, at], p[row // 2, at] = start[0, row, source], start[1, row, source]
                loose[row // 2, at] = mobility[row // 2, source]
            for row in range(pairs):
                weight[row, lane] = strength[row, source]
        # Before the first step comes one of no length, which finds the first force.
        for move in range((out.shape[0] - 1) * every * parts + 1):
            dt = dts[(move - 1) % parts] if move > 0 else reach.dtype.type(0)
            half = dt * reach.dtype.type(0.5)
            move_all(q.reshape(-1), p.reshape(-1), force.reshape(-1), loose.reshape(-1), half, dt)
            pair, out_of_reach = 0, 0
            for i in range(bodies):
                for j in range(i + 1, bodies):
                    _apart(q[i], q[j], box, work[pair])
                    if kind == RADIAL + SPLINE:
                        out_of_reach += radial_spline(
                            cells, first, reach, table, integers, work[pair]
                        )
                    elif kind == SPLINE:
                        out_of_reach += plane_spline(cells, reach, table, work[pair])
                    pair += 1
            if out_of_reach > 0 or not kind & SPLINE:
                asked += ask_networks(
                    kind, weights, back, work, count, inputs, sums, scratch, result
                )
            pair = 0
            for i in range(bodies):
                for j in range(i + 1, bodies):
                    _pull(force[i], force[j], weight[pair], work[pair])
                    pair += 1
            kick(p.reshape(-1), force.reshape(-1), half)
            if move % (every * parts) == 0:
                stored = move // (every * parts)
                _store(q, p, begin, count, out[stored])
                _look(p, work, seen)
    return asked


PairFunction = PairSpline | RadialPotential | DisplacementPotential
Packed = tuple[int, int, int, Array, Array, Array, Weights, Transposed]


def packed(potential: PairFunction, like: Tensor) -> Packed:
    """A pair function as :func:`_roll` takes it, in the floating type of ``like``."""
    real: Any = {torch.float32: np.float32, torch.float64: np.float64}[like.dtype]
    integers = np.empty(0, np.int32 if real is np.float32 else np.int64)
    network = potential.network if isinstance(potential, PairSpline) else potential
    weights, back = weights_of(network.phi, real), transposed(network.phi, real)
    kind = RADIAL if isinstance(network, RadialPotential) else 0
    if not isinstance(potential, PairSpline):
        return kind, 0, 0, np.zeros(1, real), np.zeros(0, real), integers, weights, back
    cells, first = potential.lookup(like.dtype)
    reach, table = np.array([potential.reach], real), potential.table.numpy().astype(real).ravel()
    return kind + SPLINE, cells, first, reach, table, integers, weights, back


def in_threads(part: Callable[[tuple[int, int]], Found], blocks: int) -> list[Found]:
    """``part(first, end)`` of the blocks for each thread that torch has been told to use."""
    threads = min(torch.get_num_threads(), blocks)
    if threads == 1:
        return [part((0, blocks))]
    ends = [blocks * thread // threads for thread in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(part, pairwise(ends)))


def roll(
    law: Packed,
    box: float | None,
    start: Tensor,
    mass: Tensor,
    strength: Tensor,
    dts: list[float],
    stored: int,
    every: int,
) -> tuple[Tensor, int, dict[str, float]]:
    """Leapfrog steps of a pair potential.

    Args:
        law: see :func:`packed`.
        box: side of a periodic box, or ``None``.
        start: ``(2, bodies, 2, episodes)``, q and p.
        mass: ``(bodies, episodes)``.
        strength: c(G) s_i s_j of the pairs i < j, ``(pairs, episodes)``.
        dts: seconds of the parts of a step.
        stored: states that are stored after the start.
        every: steps between them.

    Returns:
        States ``(stored + 1, 2, bodies, 2, episodes)``, the number of pairs at which a spline's
        network was asked, and how far apart and how near bodies came in any stored state, see
        :class:`dynamics.head.Trajectory`.
    """
    bodies, episodes = mass.shape
    first = start.contiguous().numpy().reshape(2, bodies * 2, episodes)
    real = first.dtype.type
    # From numpy, which asks for large pages: a fresh page costs more than what is written to it.
    out = np.empty((stored + 1, 2, bodies * 2, episodes), real)
    moved = ((1 / mass).contiguous().numpy(), strength.contiguous().numpy(), np.array(dts, real))

    def part(which: tuple[int, int]) -> tuple[int, Array]:
        seen = np.zeros((3, LANES), real)
        seen[1] = np.inf
        return _roll(*law, first, *moved, real(box or 0), every, out, seen, which), seen

    asked, seen = zip(*in_threads(part, -(-episodes // LANES)), strict=True)
    farthest, _, sound = torch.from_numpy(np.stack(seen).max((0, 2)))
    nearest = torch.from_numpy(np.stack(seen)[:, 1]).min()
    reached = {FARTHEST: float(farthest.sqrt() + sound), NEAREST: float(nearest.rsqrt() + sound)}
    return torch.from_numpy(out).reshape(stored + 1, 2, bodies, 2, episodes), sum(asked), reached
