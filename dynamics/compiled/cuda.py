"""Fused rollouts on CUDA, by Triton: one launch for all steps, the state kept in registers.

A program rolls ``EPISODES`` episodes. Bodies and pairs are axes of its tiles; what a pair has to do
with a body is a matrix of 1, -1 and 0, so that displacements and forces are sums of products.
The arithmetic is that of :mod:`dynamics.compiled.spline`, or of a network of the displacement, see
:mod:`dynamics.compiled.network_cuda`. The kernel runs in Triton's interpreter too, on the CPU,
which is how it is tested.
"""

# Triton gives its own types to what a kernel is handed, and reads its annotations itself.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import Any, cast, no_type_check

import torch
import triton
import triton.language as tl
from torch import Tensor

from dynamics.compiled import network_cuda
from dynamics.compiled.disk_kernel import CORE2, WIDE, squashed, turned
from dynamics.compiled.episodes import Episodes
from dynamics.compiled.network_cuda import BLOCKS, LEAST, largest_block
from dynamics.compiled.network_kernel import slopes
from dynamics.compiled.spline import MANTISSA, OCTAVE_DEGREE, OCTAVES, PairSpline, RadialSpline
from dynamics.pairs import pair_indices
from dynamics.potentials import SPREAD, DisplacementPotential, PairPotential

EPISODES = 32  # of a spline, that a program rolls
ROWS = LEAST, 32  # of a network, in a program: the fewest, and the most
NETWORK = {"num_warps": 8, "num_stages": 2}  # the fastest of ten tried
HALF = tl.constexpr(SPREAD / 2)
PIECES, HIGHEST = tl.constexpr(OCTAVES), tl.constexpr(OCTAVE_DEGREE)


@triton.jit
@no_type_check
def _spline(x, y, table, inside, RESOLUTION: tl.constexpr, BITS: tl.constexpr):  # noqa: ANN001, ANN202, N803
    """Gradient of the spline; where ``inside`` is false, any."""
    if BITS > 0:
        s = x * x + y * y + CORE2
        shift: tl.constexpr = BITS - RESOLUTION
        named = s.to(tl.int32 if BITS == 23 else tl.int64, bitcast=True) >> shift
        left = (named << shift).to(x.dtype, bitcast=True)
        t = (s - left) / (((named + 1) << shift).to(x.dtype, bitcast=True) - left) - 0.5
        pieces: tl.constexpr = PIECES << RESOLUTION
        at = table + (named & (pieces - 1))
        force = tl.load(at + HIGHEST * pieces)
        for k in tl.static_range(HIGHEST - 1, -1, -1):
            force = force * t + tl.load(at + k * pieces)
        gx, gy = force * x, force * y
    else:
        sign = tl.where(y < 0, -0.5, 0.5).to(x.dtype) * RESOLUTION
        u, v = squashed(x, y)
        u, v = u * sign, v * sign
        left, low = tl.floor(u), tl.floor(v)
        a, b = u - left, v - low
        cell = (left.to(tl.int32) + RESOLUTION // 2) * (RESOLUTION // 2) + low.to(tl.int32)
        at = table + tl.where(inside, cell, 0) * 36
        value, along, across = x * 0, x * 0, x * 0
        for i in tl.static_range(5, -1, -1):
            row, slope = x * 0, x * 0
            for k in tl.static_range(5, -1, -1):
                slope = slope * b + row
                row = row * b + tl.load(at + 6 * i + k)
            along = along * a + value
            value = value * a + row
            across = across * a + slope
        gx, gy = turned(x, y, along * sign, across * sign)
    return gx, gy


@triton.jit
@no_type_check
def _network(x, y, table, matrix, WIDTH: tl.constexpr, BLOCK: tl.constexpr):  # noqa: ANN001, ANN202, N803
    """See :meth:`dynamics.potentials.DisplacementPotential.pair_gradient`; u and -u are rows."""
    u, v = squashed(x, y)
    u, v = u * WIDE, v * WIDE
    rows: tl.constexpr = 2 * x.shape[0] * x.shape[1]
    u, v = tl.reshape(tl.join(u, -u), [rows])[:, None], tl.reshape(tl.join(v, -v), [rows])[:, None]
    to_u, to_v = slopes(u, v, table, matrix, table, 0, True, WIDTH, BLOCK)
    u_here, u_there = tl.split(tl.reshape(to_u, [x.shape[0], x.shape[1], 2]))
    v_here, v_there = tl.split(tl.reshape(to_v, [x.shape[0], x.shape[1], 2]))
    size = tl.load(table + 5 * WIDTH) * HALF
    return turned(x, y, (u_here - u_there) * size, (v_here - v_there) * size)


@triton.jit
@no_type_check
def _roll(  # noqa: ANN202
    start, mobility, strength, ones, others, parts, out, asked, table, matrix,  # noqa: ANN001
    episodes, bodies, pairs, substeps, moves, interval, box, reach,  # noqa: ANN001
    RESOLUTION: tl.constexpr, BITS: tl.constexpr, WIDTH: tl.constexpr,  # noqa: N803
    E: tl.constexpr, N: tl.constexpr, P: tl.constexpr, BLOCK: tl.constexpr,  # noqa: N803
):  # fmt: skip
    """Leapfrog steps of ``E`` episodes; see :func:`dynamics.compiled.cpu._roll`."""
    e = tl.program_id(0) * E + tl.arange(0, E)
    n, k = tl.arange(0, N), tl.arange(0, P)
    real = (e < episodes)[:, None] & (n < bodies)[None, :]
    body = n[None, :] * 2 * episodes + e[:, None]
    q_x, q_y = tl.load(start + body, real, 0.0), tl.load(start + body + episodes, real, 0.0)
    momenta = start + bodies * 2 * episodes + body
    p_x, p_y = tl.load(momenta, real, 0.0), tl.load(momenta + episodes, real, 0.0)
    loose = tl.load(mobility + n[None, :] * episodes + e[:, None], real, 0.0)
    counted = (e < episodes)[:, None] & (k < pairs)[None, :]
    weight = tl.load(strength + k[None, :] * episodes + e[:, None], counted, 0.0)
    here = tl.load(ones + k, k < pairs, -1)[:, None] == n[None, :]
    there = tl.load(others + k, k < pairs, -1)[:, None] == n[None, :]
    between = (here.to(q_x.dtype) - there.to(q_x.dtype))[None, :, :]
    f_x, f_y, total = q_x * 0, q_x * 0, tl.zeros([E], tl.int32)
    for move in range(moves + 1):
        # Before the first step comes one of no length, which finds the first force.
        dt = tl.load(parts + (move + substeps - 1) % substeps, move > 0, 0.0)
        half = 0.5 * dt
        p_x += half * f_x
        p_y += half * f_y
        q_x += dt * p_x * loose
        q_y += dt * p_y * loose
        x = tl.sum(between * q_x[:, None, :], 2)
        y = tl.sum(between * q_y[:, None, :], 2)
        if box > 0:
            x -= box * tl.floor(x / box + 0.5)
            y -= box * tl.floor(y / box + 0.5)
        inside = x * x + y * y + CORE2 <= reach * reach
        if WIDTH > 0:
            g_x, g_y = _network(x, y, table, matrix, WIDTH, BLOCK)
        else:
            g_x, g_y = _spline(x, y, table, inside, RESOLUTION, BITS)
        total += tl.sum((counted & (inside == 0)).to(tl.int32), 1)
        f_x = -tl.sum(between * (weight * g_x)[:, :, None], 1)
        f_y = -tl.sum(between * (weight * g_y)[:, :, None], 1)
        p_x += half * f_x
        p_y += half * f_y
        if move % interval == 0:
            to = out + (move // interval).to(tl.int64) * 4 * bodies * episodes + body
            tl.store(to, q_x, real)
            tl.store(to + episodes, q_y, real)
            tl.store(to + 2 * bodies * episodes, p_x, real)
            tl.store(to + (2 * bodies + 1) * episodes, p_y, real)
    tl.store(asked + e, total, e < episodes)


def packed(potential: PairPotential, like: Tensor) -> tuple[Any, ...]:
    """What the kernel reads of a pair function.

    Returns:
        A table; a network's matrix; the reach; a spline's resolution, and the bits of a mantissa if
        it is radial, else 0; a network's width, else 0.
    """
    if isinstance(potential, PairSpline):
        mantissa = MANTISSA[like.itemsize] if isinstance(potential, RadialSpline) else 0
        table = potential.table.to(like).contiguous()
        return table, table, potential.reach, potential.resolution, mantissa, 0
    (low, top), last = cast(DisplacementPotential, potential).phi.split()
    weights = low.weight, low.bias, top.weight, top.bias, last.weight
    table, matrix = network_cuda.packed(*(w.unsqueeze(0) for w in weights))
    return table, matrix, math.inf, 0, 0, table.shape[-1]


def _together(law: tuple[Any, ...], count: int, pairs: int, device: torch.device) -> int:
    """How many episodes a program rolls: of a network as few as keep the whole card busy."""
    *_, width = law
    if not width:
        return EPISODES
    fewest, most = (max(1, rows // (2 * pairs)) for rows in ROWS)
    card = device.type == "cuda" and torch.cuda.get_device_properties(device)
    share = triton.cdiv(count, card.multi_processor_count if card else 1)
    return min(most, max(fewest, triton.next_power_of_2(share)))


def roll(
    law: tuple[Any, ...],
    box: float | None,
    episodes: Episodes,
    dts: list[float],
    stored: int,
    every: int,
) -> tuple[Tensor, Tensor, int, None]:
    """Leapfrog steps of a spline or a network; see :func:`dynamics.compiled.cpu.roll`.

    Returns:
        q and p, and the number of pairs that were out of reach: if there are any, the states mean
        nothing, and the rollout has to be made by the torch twin, which asks the network. What
        they reached is not looked at.
    """
    table, matrix, reach, *kind = law
    count, bodies = episodes.mass.shape
    start = torch.stack(episodes[:2]).permute(0, 2, 3, 1).contiguous()
    i, j = pair_indices(bodies, start.device)
    product = episodes.amount[:, i] * episodes.amount[:, j]
    strength = (episodes.strength.unsqueeze(-1) * product).T.contiguous()
    out = start.new_empty(stored + 1, *start.shape)
    tile = triton.next_power_of_2(len(i))
    together = _together(law, count, tile, start.device)
    asked = torch.zeros(count, dtype=torch.int32, device=start.device)
    given = (
        start, (1 / episodes.mass).T.contiguous(), strength, i, j, start.new_tensor(dts),
        out, asked, table, matrix,
        count, bodies, len(i), len(dts), stored * every * len(dts), every * len(dts),
        float(box or 0), float(reach), *kind,
    )  # fmt: skip
    _launch(triton.cdiv(count, together), given, together, triton.next_power_of_2(bodies), tile)
    q, p = out.permute(1, 4, 0, 2, 3)
    return q, p, int(asked.sum()), None


def _launch(programs: int, given: tuple[Any, ...], episodes: int, bodies: int, pairs: int) -> None:
    """Roll them; of a network, by the largest blocks that the card's processors have memory for.

    Args:
        programs: each of so many ``episodes``, ``bodies`` and ``pairs``, powers of 2.
        given: what the kernel is handed; a network's width is last.
    """
    sizes = {"E": episodes, "N": bodies, "P": pairs}
    *others, width = given
    if width:
        largest_block(_roll, (programs,), others, width, BLOCKS, **sizes, **NETWORK)
    else:
        with torch.cuda.device_of(others[0]):
            _roll[(programs,)](*others, **sizes, WIDTH=0, BLOCK=0)
