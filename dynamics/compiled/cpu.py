"""Fused rollouts on the CPU, by numba: all steps of a block of episodes before the next block.

Blocks run on as many threads as torch has been told to use.
"""

from __future__ import annotations

from math import inf, prod, sqrt
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dynamics.compiled.episodes import Episodes
from dynamics.compiled.lanes import (
    BLOCK,
    PART,
    TILE,
    Array,
    Transposed,
    Weights,
    aligned,
    transposed,
    weights_of,
)
from dynamics.compiled.pairs import LANES, RADIAL, ROWS, SPLINE, PairFunction
from dynamics.compiled.spline import PairSpline
from dynamics.compiled.steps import steps, sum_of
from dynamics.domain import FARTHEST, NEAREST
from dynamics.potentials import DisplacementPotential, RadialPotential
from loops.kernels import kernel
from loops.threads import in_threads


@kernel
def _roll(
    kind: int,
    resolution: int,
    reach: Array,
    table: Array,
    weights: Weights,
    back: Transposed,
    start: tuple[Array, Array],
    mass: Array,
    strength: Array,
    amount: Array,
    dts: Array,
    box: Any,
    every: int,
    out: Array,
    which: tuple[int, int],
) -> tuple[int, float, float, float]:
    """Leapfrog steps of some episodes, in blocks.

    Args:
        kind, resolution, reach, table, weights, back: see :class:`PairFunction`, which as one
            argument would cost a microsecond a call.
        dts, box, every, out: see :func:`steps`.
        start: q and p, ``(episodes, bodies, 2)`` each.
        mass, strength, amount: see :class:`dynamics.compiled.episodes.Episodes`.
        which: the first episode, and the one after the last.

    Returns:
        Pairs at which a network was asked, the largest and the smallest squared distance at which
        a force was, and a sum that is finite where all states are.
    """
    bodies = mass.shape[1]
    pairs = bodies * (bodies - 1) // 2
    law = PairFunction(kind, resolution, reach, table, weights, back)
    asked, one = 0, reach.dtype.type(1)
    layers, units = weights.biases.shape
    shape, total = (bodies, 2, LANES), 0.0
    seen = np.zeros((2, LANES), reach.dtype)
    seen[1] = np.inf
    for begin in range(which[0], which[1], LANES):
        count = min(LANES, which[1] - begin)
        used = -(-count // PART) * PART
        q, p = aligned(bodies * 2 * LANES, reach), aligned(bodies * 2 * LANES, reach)
        force, loose = aligned(bodies * 2 * LANES, reach), aligned(bodies * 2 * LANES, reach)
        of_q, of_p, of_force = q.reshape(shape), p.reshape(shape), force.reshape(shape)
        weight = aligned(pairs * LANES, reach).reshape((pairs, LANES))
        work = aligned(pairs * ROWS * LANES, reach).reshape((pairs, ROWS, LANES))
        inputs, result = aligned(BLOCK * TILE, reach), aligned(BLOCK * TILE, reach)
        sums = aligned(BLOCK * PART, reach)
        scratch = aligned(2 * layers * units * TILE, reach).reshape((2 * layers, units * TILE))
        room = inputs, sums, scratch, result
        inputs[:] = 0
        force[:] = 0
        for lane in range(LANES):
            source = begin + min(lane % used, count - 1)  # lanes of no episode repeat others
            pair = 0
            for i in range(bodies):
                for axis in range(2):
                    of_q[i, axis, lane] = start[0][source, i, axis]
                    of_p[i, axis, lane] = start[1][source, i, axis]
                    loose[(2 * i + axis) * LANES + lane] = one / mass[source, i]
                for j in range(i + 1, bodies):
                    product = amount[source, i] * amount[source, j]
                    weight[pair, lane] = strength[source] * product
                    pair += 1
        asked += steps(
            law, (q, p, force, loose), (of_q, of_p, of_force), weight, work, room, dts, box, every,
            out, begin, count, seen,
        )  # fmt: skip
        total += sum_of(q, p)
    return asked, seen[0].max(), seen[1].min(), total


def packed(
    potential: PairSpline | RadialPotential | DisplacementPotential, like: Tensor
) -> PairFunction:
    """A pair function as :func:`_roll` takes it, in the floating type of ``like``."""
    real: Any = {torch.float32: np.float32, torch.float64: np.float64}[like.dtype]
    network = potential.network if isinstance(potential, PairSpline) else potential
    weights, back = weights_of(network.phi, real), transposed(network.phi, real)
    kind = RADIAL if isinstance(network, RadialPotential) else 0
    if not isinstance(potential, PairSpline):
        return PairFunction(kind, 0, np.zeros(1, real), np.zeros(0, real), weights, back)
    reach, table = np.array([potential.reach], real), potential.table.numpy().astype(real).ravel()
    return PairFunction(kind + SPLINE, potential.resolution, reach, table, weights, back)


def states(shape: tuple[int, ...], real: Any) -> Array:
    """Room for what is stored, from the beginning of a cache line on.

    It comes from numpy, which asks for large pages: a fresh page costs more than what is written.
    """
    raw = np.empty(prod(shape) + 16, real)
    skip = -raw.__array_interface__["data"][0] % 64 // raw.itemsize
    return raw[skip : skip + prod(shape)].reshape(shape)


def roll(
    law: PairFunction,
    box: float | None,
    episodes: Episodes,
    dts: list[float],
    stored: int,
    every: int,
) -> tuple[Tensor, Tensor, int, dict[str, float]]:
    """Leapfrog steps of a pair potential.

    Args:
        law: see :func:`packed`.
        box: side of a periodic box, or ``None``.
        episodes: where they start, and under which law.
        dts: seconds of the parts of a step.
        stored: states that are stored after the start.
        every: steps between them.

    Returns:
        q and p ``(episodes, stored + 1, bodies, 2)``, views of memory in which episodes lie
        innermost; the number of pairs at which a spline's network was asked; how far apart and
        how near bodies came, see :class:`dynamics.head.Trajectory`.
    """
    q, p, *law_of = (np.ascontiguousarray(x.numpy()) for x in episodes)
    real, (count, bodies, _) = q.dtype.type, q.shape
    out = states((stored + 1, 2, bodies, 2, count), real)
    parts, side = np.array(dts, real), real(box or 0)
    # A network's time is that of the lanes in use, a spline's that of whole blocks.
    unit = LANES if law.kind & SPLINE else PART

    def part(which: tuple[int, int]) -> tuple[int, float, float, float]:
        some = which[0] * unit, min(which[1] * unit, count)
        return _roll(*law, (q, p), *law_of, parts, side, every, out, some)

    asked, far, near, total = zip(*in_threads(part, -(-count // unit)), strict=True)
    bad = 0 * sum(total)  # NaN if any state is not finite
    nearness = sqrt(1 / min(near)) if min(near) > 0 else inf
    reached = {FARTHEST: sqrt(max(far)) + bad, NEAREST: nearness + bad}
    moved_q, moved_p = out.transpose(1, 4, 0, 2, 3)
    return torch.from_numpy(moved_q), torch.from_numpy(moved_p), sum(asked), reached
