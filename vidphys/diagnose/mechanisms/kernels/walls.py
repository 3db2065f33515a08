"""Walls: when moving coordinates meet one, how they leave it, how they lie at it; compiled loops.

There are walls n.s = place, at which the speed across them turns round and shrinks. A solid ball
that spins in the plane slips at a wall with u = v.t + w, where t is the normal turned by a right
angle and w the speed of its surface; what grips it turns u to -e u, and what that takes from v.t is
what it gives to the spin, 2/5 w (Garwin 1969, Am. J. Phys. 37).
What pushes a body that lies at a wall into it, the wall takes up.
When a step meets a wall is found by Newton's method. The numbers of a wall are those of
:func:`.motion_kernel.rolled`.
"""

from __future__ import annotations

import numpy as np

from loops import uncounted
from vidphys.diagnose.mechanisms.kernels.forces import step

MEETING, TIGHT = 40, 1e-13  # tries at most to find when a step meets a wall; of the step, exact so
SOLID = 0.4  # moment of inertia of a solid ball over its mass and squared radius


@uncounted
def beyond(
    s: np.ndarray,
    wall: np.ndarray,
) -> float:
    """How far a place is beyond a wall; below zero before it."""
    depth = -wall[len(s)]
    for i in range(len(s)):
        depth += wall[i] * s[i]
    return depth


@uncounted
def speed_into(
    v: np.ndarray,
    wall: np.ndarray,
) -> float:
    """Speed into a wall."""
    speed = 0.0
    for i in range(len(v)):
        speed += wall[i] * v[i]
    return speed


@uncounted
def meets(
    s: np.ndarray,
    v: np.ndarray,
    most: float,
    wall: np.ndarray,
    law: tuple,
    work: np.ndarray,
) -> float:
    """Seconds until a step that ends beyond a wall meets it; ``work`` is left as it is then."""
    low, high, moment = 0.0, most, most
    for _try in range(MEETING):
        depth, across = beyond(work[8], wall), speed_into(work[9], wall)
        if abs(depth) <= TIGHT * most * abs(across):
            break
        if depth > 0.0:
            high = moment
        else:
            low = moment
        straight = moment - depth / across if across > 0.0 else low
        moment = straight if low < straight < high else 0.5 * (low + high)
        step(s, v, moment, law, work)
    return moment


@uncounted
def pressed(
    work: np.ndarray,
    wall: np.ndarray,
) -> bool:
    """Whether a step went beyond the wall at which a body lies; if so it is put back onto it."""
    depth, into = beyond(work[8], wall), max(speed_into(work[9], wall), 0.0)
    if depth <= 0.0:
        return False
    for i in range(work.shape[1]):
        work[8, i] -= depth * wall[i]
        work[9, i] -= into * wall[i]
    return True


@uncounted
def turn_round(
    s: np.ndarray,
    v: np.ndarray,
    wall: np.ndarray,
    spin: np.ndarray,
) -> None:
    """Turn the speed across a wall round; what is along it keeps a share of its own, or spins."""
    size = len(s)
    across, depth = speed_into(v, wall), beyond(s, wall)
    restitution, along = wall[size + 1], wall[size + 2]
    if len(spin) > 0:
        slip = v[1] * wall[0] - v[0] * wall[1] + spin[0]
        change = -(1 + along) * slip * SOLID / (1 + SOLID)
        spin[0] += change / SOLID
        v[0] -= change * wall[1]
        v[1] += change * wall[0]
        along = 1.0
    for i in range(size):
        s[i] -= depth * wall[i]
        v[i] = along * (v[i] - across * wall[i]) - restitution * across * wall[i]
