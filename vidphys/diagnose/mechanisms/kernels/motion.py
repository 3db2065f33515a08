"""The motion of a few coordinates under a law of a few numbers, stepped in compiled loops.

With coordinates s and v = ds/dt,

    dv/dt = force - stiffness s - swing sin s - linear v - square |v| v - dry v/|v|

where springs between pendulums join their ends, and are slack where both hang; or, of two rods that
hang end on end, with link b, inertia a and d = s_1 - s_2,

    dv_1/dt + b (cos d dv_2/dt + sin d v_2^2) = -swing_1 sin s_1 - friction
    a dv_2/dt + b (cos d dv_1/dt - sin d v_1^2) = -swing_2 sin s_2 - friction

A fixed place c may push with strength (near / r)^power + steady along s - c, r = |s - c|; what
pulls has a strength below zero. With power -1 it is a spring, and steady what its rest length adds.
What is known to push adds an acceleration of its own, straight between the times at which it was
recorded. A lift pushes what spins across its way in the plane, by lift (-v_2, v_1), and fades with
its spin (Magnus effect; Mehta 1985, Annu. Rev. Fluid Mech. 17).
A magnetic field, or a frame that turns, adds turning x v, which does not fade.
There are walls, at which bodies bounce or lie, see :mod:`.walls_kernel`.
Steps are fourth-order Runge-Kutta; the step that meets a wall ends there.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from loops import kernel, uncounted
from vidphys.diagnose.mechanisms.kernels.forces import holds, step
from vidphys.diagnose.mechanisms.kernels.walls import (
    beyond,
    meets,
    pressed,
    speed_into,
    turn_round,
)

LANDED = 1e-3  # of the recording: a flight shorter than this ends at the wall
BOUNCES = 6  # in a step, at most
NONE, NO_RODS, NO_LIFT = np.empty(0), np.zeros(2), np.zeros(2)


@uncounted
def _rolled(
    times: np.ndarray,
    start: np.ndarray,
    law: tuple,
    steady: np.ndarray,
    walls: np.ndarray,
    most: float,
    when: np.ndarray,
    pushed: np.ndarray,
    spin: np.ndarray,
    lift: tuple,
    work: np.ndarray,
    out: np.ndarray,
) -> None:
    """One of them; ``work`` has room for eleven vectors, and for the place and the speed."""
    size = start.shape[1]
    force, ramp, stiffness, swing, friction, _apart, _rods, centre, hung, floor = law
    at = 0
    s, v = work[11], work[12]
    for i in range(size):
        s[i], v[i] = start[0, i], start[1, i]
        out[0, 0, i], out[0, 1, i] = s[i], v[i]
    landed = LANDED * (times[-1] - times[0])
    stuck, lies, since = False, -1, np.inf
    for frame in range(1, len(times)):
        gap = times[frame] - times[frame - 1]
        count = int(np.ceil(gap / most))
        h = gap / count
        for number in range(count):
            if stuck:
                break
            left = h
            if lift[0] != 0.0:
                friction[3] = lift[0] * np.exp(-lift[1] * (times[frame - 1] + (number + 0.5) * h))
            if len(when) > 0:  # as it is when the step begins, and on along a straight line
                for end in range(2):
                    now = times[frame - 1] + (number + end) * h
                    while at < len(when) - 2 and when[at + 1] < now:
                        at += 1
                    part = min(max((now - when[at]) / (when[at + 1] - when[at]), 0.0), 1.0)
                    for i in range(size):
                        push = steady[i] + (1 - part) * pushed[at, i] + part * pushed[at + 1, i]
                        if end == 0:
                            force[i] = push
                        else:
                            ramp[i] = (push - force[i]) / h
            for bounce in range(BOUNCES):
                step(s, v, left, law, work)
                hit, moment = -1, left
                for k in range(len(walls)):
                    if k != lies and beyond(work[8], walls[k]) > 0.0:
                        hit, moment = k, meets(s, v, moment, walls[k], law, work)
                if lies >= 0 and not pressed(work, walls[lies]):
                    lies = -1
                    for i in range(size):
                        floor[i] = 0.0
                if hit < 0:
                    break
                for i in range(size):
                    s[i], v[i] = work[8, i], work[9, i]
                turn_round(s, v, walls[hit], spin)
                for i in range(size):
                    force[i] += moment * ramp[i]
                left -= moment
                since += moment
                # It lies at the wall: only what is along it goes on, for which one turn is left.
                if since < landed or bounce == BOUNCES - 2:
                    across = speed_into(v, walls[hit])
                    for i in range(size):
                        v[i] -= across * walls[hit, i]
                        floor[i] = walls[hit, i]
                    lies, stuck = hit, size == 1
                since = 0.0
                if left <= 0.0 or stuck:
                    break
            if stuck or hit >= 0:  # in a corner nothing goes on
                continue
            turned = 0.0  # by the step's last look ahead: friction that turns round hides the rest
            for i in range(size):
                turned += v[i] * work[7, i]
            for i in range(size):
                s[i], v[i] = work[8, i], work[9, i]
            since += left
            if (
                friction[2] > 0.0
                and turned <= 0.0
                and holds(s, force, stiffness, swing, friction[2], centre, hung, floor)
            ):
                for i in range(size):
                    v[i] = 0.0
                stuck = True
        for i in range(size):
            out[frame, 0, i], out[frame, 1, i] = s[i], v[i]


@kernel
def _all_rolled(
    times: np.ndarray,
    starts: np.ndarray,
    laws: tuple,
    apart: bool,
    hung: np.ndarray,
    walls: np.ndarray,
    most: float,
    when: np.ndarray,
    pushed: np.ndarray,
    spin: np.ndarray,
    lift: np.ndarray,
    out: np.ndarray,
) -> None:
    force, stiffness, swing, friction, rods, centre = laws
    size = starts.shape[2]
    work, own = np.empty((13, size)), np.empty((3, size))
    for b in range(len(starts)):
        for i in range(size):
            own[0, i], own[1, i], own[2, i] = force[b, i], 0.0, 0.0
        law = (
            own[0],
            own[1],
            stiffness[b],
            swing[b],
            friction[b],
            apart,
            rods[b],
            centre[b],
            hung,
            own[2],
        )
        fades = (lift[b, 0], lift[b, 1])
        _rolled(
            times,
            starts[b],
            law,
            force[b],
            walls[b],
            most,
            when,
            pushed[b],
            spin[b],
            fades,
            work,
            out[b],
        )


def rolled(
    times: Float[np.ndarray, " t"],
    start: Float[np.ndarray, "*b 2 k"],
    force: Float[np.ndarray, "*b k"],
    stiffness: Float[np.ndarray, "*b k k"],
    swing: Float[np.ndarray, "*b k"],
    friction: Float[np.ndarray, "*#b 3"],
    walls: Float[np.ndarray, "*b w _"],
    most: float,
    apart: bool = False,
    rods: Float[np.ndarray, "*#b 2"] = NO_RODS,
    pushed: tuple[np.ndarray, np.ndarray] | None = None,
    spin: float | Float[np.ndarray, "*b"] | None = None,
    centre: Float[np.ndarray, "*#b _"] = NONE,
    hung: Float[np.ndarray, " _"] = NONE,
    lift: Float[np.ndarray, "*#b 2"] = NO_LIFT,
    turning: Float[np.ndarray, "*#b _"] = NONE,
) -> Float[np.ndarray, "*b t 2 k"]:
    """Coordinates and their rates at each time, of one law or of several at once.

    Args:
        times: seconds, increasing; the start is at the first.
        start: coordinates and rates.
        force, stiffness, swing: accelerations, see the module.
        friction: the linear rate, the square one, and the dry deceleration.
        walls: of each its normal ``(k,)``, place, restitution, and the share of the speed along it
            that a bounce leaves; of a ball that spins the restitution along it, -1 where it slips
            freely and 1 where it grips without loss.
        most: seconds of a step at most.
        rods: link and inertia of two rods that hang end on end; no inertia: there are none.
        pushed: times in seconds, two or more, and what is known to push then, accelerations
            ``(…, u, k)``.
        spin: of a ball in the plane, the speed of its surface at the start; ``None``: none spins.
        centre: a place that pushes each body, its strength, its power, the distance at which it has
            that strength, and a push that is the same at all distances, ``(…, d + 4)``; empty:
            there is none.
        hung: of pendulums that springs join, where each hangs along a level line, over their
            length, ``(k,)``; empty: springs join the coordinates.
        lift: across the way over the speed, per second, at time zero; and the share a second by
            which it fades.
        turning: radians per second, about the axis across the plane or about each axis of space,
            ``(…, 1)`` or ``(…, 3)``; empty: there is none.
        apart: friction goes with each coordinate's own speed, not with the length of the velocity.
    """
    count, size = math.prod(start.shape[:-2]), start.shape[-1]
    lossy = np.zeros((count, 6))  # frictions, then turning about z, x and y
    lossy[:, :3] = friction
    axes = turning.shape[-1]
    if axes:
        lossy[:, 3 : 3 + axes] = turning[..., [-1, 0, 1][:axes]]
    when, known = pushed or (NONE, np.empty((0, size)))
    spins = NONE if spin is None else np.asarray(spin)[..., None]
    laws = (
        _every(force, count, 1),
        _every(stiffness, count, 2),
        _every(swing, count, 1),
        lossy,
        _every(rods, count, 1),
        _every(centre, count, 1),
    )
    out = np.empty((count, len(times), 2, size))
    _all_rolled(
        times,
        _every(start, count, 2),
        laws,
        apart,
        hung,
        _every(walls, count, 2),
        most,
        when,
        _every(known, count, 2),
        _every(spins, count, 1),
        _every(lift, count, 1),
        out,
    )
    return out.reshape(*start.shape[:-2], *out.shape[1:])


def _every(numbers: np.ndarray, count: int, axes: int) -> np.ndarray:
    """Numbers of every law ``(count, …)``, of which each has so many axes."""
    shape = (count, *numbers.shape[numbers.ndim - axes :])
    if numbers.shape == shape and numbers.flags.c_contiguous:
        return numbers
    return np.broadcast_to(numbers, shape).copy()
