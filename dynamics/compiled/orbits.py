"""Leapfrog steps of a learned pair law on blocks of episodes, forward and back, for numba.

``LANES`` episodes lie side by side. A pair of each, seen from either body, is a tile of rows of
its network, see :mod:`dynamics.compiled.rows`. What is trained through it is
:class:`dynamics.potentials.DisplacementPotential` under |p|^2 / 2m.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dynamics.compiled.lanes import Array
from dynamics.compiled.rows import ROWS, Layers, backward_rows, gradient_rows
from dynamics.potentials import CORE, REACH, SPREAD
from loops.kernels import kernel

LANES = ROWS // 2


class Law(NamedTuple):
    """What blocks of episodes are under.

    Args:
        mobility: 1 / m, ``(blocks, bodies, LANES)``.
        weight: c(G) s_i s_j, ``(blocks, pairs, LANES)``.
        dt: seconds of a step.
        every: steps between stored states.
    """

    mobility: Array
    weight: Array
    dt: Any
    every: int


class Trace(NamedTuple):
    """What blocks of episodes leave behind for the way back.

    Args:
        places: q of each force, ``(blocks, steps + 1, bodies * 2, LANES)``.
        slopes: of the network there, ``(blocks, steps + 1, pairs, ROWS, 2)``.
        top, sent: see :func:`dynamics.compiled.rows.gradient_rows`, of each of them,
            ``(blocks, steps + 1, pairs, panels, ROWS, PANEL)``, or of one, where they are not kept.
    """

    places: Array
    slopes: Array
    top: Array
    sent: Array


@kernel
def _look(q: Array, x: Array) -> None:
    """What the network sees of the bodies at ``q (bodies * 2, LANES)``, ``(pairs, ROWS, 2)``."""
    one, spread, reach = q.dtype.type(1), q.dtype.type(SPREAD), q.dtype.type(REACH)
    core, pair = q.dtype.type(CORE * CORE), 0
    for i in range(0, q.shape[0], 2):
        for j in range(i + 2, q.shape[0], 2):
            for lane in range(LANES):
                dx, dy = q[i, lane] - q[j, lane], q[i + 1, lane] - q[j + 1, lane]
                scale = spread * (one / (reach + np.sqrt(dx * dx + dy * dy + core)))
                x[pair, lane, 0], x[pair, lane, 1] = scale * dx, scale * dy
                x[pair, LANES + lane, 0], x[pair, LANES + lane, 1] = -scale * dx, -scale * dy
            pair += 1


@kernel
def _pull(q: Array, weight: Array, slope: Array, force: Array) -> None:
    """The forces, written, ``(bodies * 2, LANES)``.

    Args:
        q: positions, likewise.
        weight: c(G) s_i s_j, ``(pairs, LANES)``.
        slope: of the network at what it sees, ``(pairs, ROWS, 2)``.
        force: of each body.
    """
    one, half, reach = q.dtype.type(1), q.dtype.type(0.5 * SPREAD), q.dtype.type(REACH)
    core, pair = q.dtype.type(CORE * CORE), 0
    force[:] = 0
    for i in range(0, q.shape[0], 2):
        for j in range(i + 2, q.shape[0], 2):
            for lane in range(LANES):
                dx, dy = q[i, lane] - q[j, lane], q[i + 1, lane] - q[j + 1, lane]
                r = np.sqrt(dx * dx + dy * dy + core)
                shrink = one / (reach + r)
                sx = half * (slope[pair, lane, 0] - slope[pair, LANES + lane, 0])
                sy = half * (slope[pair, lane, 1] - slope[pair, LANES + lane, 1])
                inward = (dx * sx + dy * sy) * shrink * shrink / r
                pull_x = weight[pair, lane] * (sx * shrink - dx * inward)
                pull_y = weight[pair, lane] * (sy * shrink - dy * inward)
                force[i, lane] -= pull_x
                force[i + 1, lane] -= pull_y
                force[j, lane] += pull_x
                force[j + 1, lane] += pull_y
            pair += 1


@kernel
def _pull_back(
    q: Array, weight: Array, slope: Array, on_force: Array, on_q: Array, on_slope: Array
) -> None:
    """What reaches the slopes, written, and the positions by another way than the network, added.

    Args:
        q, weight, slope: see :func:`_pull`.
        on_force: what reaches the forces.
    """
    one, two, reach = q.dtype.type(1), q.dtype.type(2), q.dtype.type(REACH)
    half, core, pair = q.dtype.type(0.5 * SPREAD), q.dtype.type(CORE * CORE), 0
    for i in range(0, q.shape[0], 2):
        for j in range(i + 2, q.shape[0], 2):
            for lane in range(LANES):
                dx, dy = q[i, lane] - q[j, lane], q[i + 1, lane] - q[j + 1, lane]
                r = np.sqrt(dx * dx + dy * dy + core)
                a = one / (reach + r)  # a pair's gradient is a s - b (d . s) d
                b = a * a / r
                sx = half * (slope[pair, lane, 0] - slope[pair, LANES + lane, 0])
                sy = half * (slope[pair, lane, 1] - slope[pair, LANES + lane, 1])
                gx = weight[pair, lane] * (on_force[j, lane] - on_force[i, lane])
                gy = weight[pair, lane] * (on_force[j + 1, lane] - on_force[i + 1, lane])
                ds, dg, sg = dx * sx + dy * sy, dx * gx + dy * gy, sx * gx + sy * gy
                back_x, back_y = half * (a * gx - b * dg * dx), half * (a * gy - b * dg * dy)
                on_slope[pair, lane, 0], on_slope[pair, lane, 1] = back_x, back_y
                on_slope[pair, LANES + lane, 0] = -back_x
                on_slope[pair, LANES + lane, 1] = -back_y
                along = ds * dg * b * (two * a + one / r) / r - sg * b
                on_x = along * dx - b * (dg * sx + ds * gx)
                on_y = along * dy - b * (dg * sy + ds * gy)
                on_q[i, lane] += on_x
                on_q[i + 1, lane] += on_y
                on_q[j, lane] -= on_x
                on_q[j + 1, lane] -= on_y
            pair += 1


@kernel
def _look_back(q: Array, on_seen: Array, on_q: Array) -> None:
    """From what reaches what the network sees to what reaches the positions, added."""
    one, spread, reach = q.dtype.type(1), q.dtype.type(SPREAD), q.dtype.type(REACH)
    core, pair = q.dtype.type(CORE * CORE), 0
    for i in range(0, q.shape[0], 2):
        for j in range(i + 2, q.shape[0], 2):
            for lane in range(LANES):
                dx, dy = q[i, lane] - q[j, lane], q[i + 1, lane] - q[j + 1, lane]
                r = np.sqrt(dx * dx + dy * dy + core)
                a = one / (reach + r)
                ux = spread * (on_seen[pair, lane, 0] - on_seen[pair, LANES + lane, 0])
                uy = spread * (on_seen[pair, lane, 1] - on_seen[pair, LANES + lane, 1])
                inward = (dx * ux + dy * uy) * a * a / r
                on_x, on_y = a * ux - inward * dx, a * uy - inward * dy
                on_q[i, lane] += on_x
                on_q[i + 1, lane] += on_y
                on_q[j, lane] -= on_x
                on_q[j + 1, lane] -= on_y
            pair += 1


@kernel
def _kick(p: Array, force: Array, dt: Any) -> None:
    for i in range(p.shape[0]):
        for lane in range(LANES):
            p[i, lane] += dt * force[i, lane]


@kernel
def _drift(q: Array, p: Array, mobility: Array, dt: Any) -> None:
    for i in range(p.shape[0]):
        for lane in range(LANES):
            q[i, lane] += dt * mobility[i // 2, lane] * p[i, lane]


@kernel
def forward_blocks(
    net: Layers, law: Law, state: Array, trace: Trace, out: Array, blocks: tuple[int, int]
) -> None:
    """All steps of some blocks of episodes, one block after another.

    Args:
        net: see :class:`dynamics.compiled.rows.Layers`.
        law: see :class:`Law`.
        state: q and p at the start, ``(blocks, 2, bodies * 2, LANES)``; moved on.
        trace: written.
        out: states, written, ``(blocks, stored + 1, 2, bodies * 2, LANES)``; the start first.
        blocks: the first of them, and the one after the last.
    """
    dt, half, pairs = law.dt, law.dt * state.dtype.type(0.5), trace.slopes.shape[2]
    seen = np.empty(trace.slopes.shape[2:], state.dtype)
    force = np.empty(state.shape[2:], state.dtype)
    for block in range(blocks[0], blocks[1]):
        q, p, weight = state[block, 0], state[block, 1], law.weight[block]
        own = block if trace.top.shape[0] > 1 else 0
        out[block, 0] = state[block]
        for step in range(trace.places.shape[1]):
            at = step if trace.top.shape[1] > 1 else 0
            if step > 0:
                _kick(p, force, half)
                _drift(q, p, law.mobility[block], dt)
            trace.places[block, step] = q
            _look(q, seen)
            slope = trace.slopes[block, step]
            gradient_rows(net, seen, trace.top[own, at], trace.sent[own, at], slope, (0, pairs))
            _pull(q, weight, slope, force)
            if step > 0:
                _kick(p, force, half)
                if step % law.every == 0:
                    out[block, step // law.every] = state[block]


@kernel
def backward_blocks(
    net: Layers,
    law: Law,
    trace: Trace,
    upstream: Array,
    on_state: Array,
    total: Layers,
    blocks: tuple[int, int],
) -> None:
    """From a gradient with respect to the stored states to one of the start and the weights.

    Args:
        net, law, trace, blocks: as the way forward.
        upstream: shape of its ``out``.
        on_state: written, ``(blocks, 2, bodies * 2, LANES)``.
        total: gradients are added, in the form of the weights.
    """
    dt, half, pairs = law.dt, law.dt * on_state.dtype.type(0.5), trace.slopes.shape[2]
    shape, real = trace.slopes.shape[2:], on_state.dtype
    seen, on_slope, on_seen = np.empty(shape, real), np.empty(shape, real), np.empty(shape, real)
    on_force = np.empty(on_state.shape[2:], real)
    for block in range(blocks[0], blocks[1]):
        on_q, on_p, weight = on_state[block, 0], on_state[block, 1], law.weight[block]
        on_state[block] = 0
        on_force[:] = 0
        for step in range(trace.places.shape[1] - 1, -1, -1):
            if step > 0 and step % law.every == 0:
                on_state[block] += upstream[block, step // law.every]
            if step > 0:
                _kick(on_force, on_p, half)
            q = trace.places[block, step]
            _pull_back(q, weight, trace.slopes[block, step], on_force, on_q, on_slope)
            _look(q, seen)
            top, sent = trace.top[block, step], trace.sent[block, step]
            backward_rows(net, seen, top, sent, on_slope, on_seen, total, (0, pairs))
            _look_back(q, on_seen, on_q)
            if step > 0:
                _drift(on_p, on_q, law.mobility[block], dt)
                on_force[:] = 0
                _kick(on_force, on_p, half)
        on_state[block] += upstream[block, 0]
