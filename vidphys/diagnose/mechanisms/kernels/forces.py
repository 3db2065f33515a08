"""What accelerates generalised coordinates, and one step of their motion, in compiled loops.

The terms are those of :mod:`.motion_kernel`. A step is fourth-order Runge-Kutta.
"""

from __future__ import annotations

import numpy as np

from loops import part, uncounted

CLOSEST = 1e-9  # of the distance ``near``: a body that runs into a place that pulls stays finite


@part
def _from_centre(s: np.ndarray, first: int, centre: np.ndarray) -> float:
    """Acceleration away from a fixed place, over the distance, of the body whose coordinates begin
    with the ``first``.
    """
    size, squared = len(centre) - 4, 0.0
    for i in range(size):
        squared += (s[first + i] - centre[i]) ** 2
    strength, power, near = centre[size], centre[size + 1], centre[size + 2]
    far = np.sqrt(squared) / near + CLOSEST
    return strength / near * far ** (-power - 1.0) + centre[size + 3] / (near * far)


@part
def _stretched(one: float, two: float, apart: float) -> float:
    """By how much a spring between the ends of two pendulums is longer than their pivots are apart.

    Along the way of the first one's end; lengths are over the pendulums'.
    """
    across, up = apart + np.sin(two) - np.sin(one), np.cos(one) - np.cos(two)
    far = np.sqrt(across * across + up * up)
    return (1.0 - abs(apart) / far) * (across * np.cos(one) + up * np.sin(one))


@part
def _pull(
    i: int,
    s: np.ndarray,
    force: np.ndarray,
    stiffness: np.ndarray,
    swing: np.ndarray,
    hung: np.ndarray,
) -> float:
    """Acceleration of a coordinate by what depends on all places alone."""
    total = force[i]
    if swing[i] != 0.0:  # a sine costs more than all the rest
        total -= swing[i] * np.sin(s[i])
    for j in range(len(s)):
        if len(hung) == 0:
            total -= stiffness[i, j] * s[j]
        elif j != i:
            total -= stiffness[i, j] * _stretched(s[i], s[j], hung[j] - hung[i])
    return total


@part
def _accelerate(
    s: np.ndarray,
    v: np.ndarray,
    force: np.ndarray,
    stiffness: np.ndarray,
    swing: np.ndarray,
    friction: np.ndarray,
    apart: bool,
    rods: np.ndarray,
    centre: np.ndarray,
    hung: np.ndarray,
    floor: np.ndarray,
    out: np.ndarray,
) -> None:
    size = len(s)
    speed, into = 0.0, 0.0
    for i in range(size):
        speed += v[i] * v[i]
        into += v[i] * floor[i]
    into = max(into, 0.0)  # what a step falls into the floor rubs nothing
    speed = np.sqrt(max(speed - into * into, 0.0))
    for i in range(size):
        own = abs(v[i]) if apart else speed
        rate = friction[0] + friction[1] * own
        if own > 0.0:
            rate += friction[2] / own
        out[i] = _pull(i, s, force, stiffness, swing, hung) - rate * (v[i] - into * floor[i])
    if size > 1 and friction[3] != 0.0:
        out[0] -= friction[3] * v[1]
        out[1] += friction[3] * v[0]
    if size == 3:
        out[0] += friction[5] * v[2]
        out[1] -= friction[4] * v[2]
        out[2] += friction[4] * v[1] - friction[5] * v[0]
    if len(centre) > 0:
        each = len(centre) - 4
        for first in range(0, size, each):
            away = _from_centre(s, first, centre)
            for i in range(each):
                out[first + i] += away * (s[first + i] - centre[i])
    if rods[1] > 0.0:
        d = s[0] - s[1]
        across, link = np.sin(d) * rods[0], np.cos(d) * rods[0]
        one, two = out[0] - across * v[1] * v[1], out[1] + across * v[0] * v[0]
        size_of = rods[1] - link * link
        out[0] = (rods[1] * one - link * two) / size_of
        out[1] = (two - link * one) / size_of


@uncounted
def holds(
    s: np.ndarray,
    force: np.ndarray,
    stiffness: np.ndarray,
    swing: np.ndarray,
    dry: float,
    centre: np.ndarray,
    hung: np.ndarray,
    floor: np.ndarray,
) -> bool:
    """Whether dry friction holds what stands at ``s``."""
    pull, into, away, each = 0.0, 0.0, 0.0, max(len(centre) - 4, 1)
    for i in range(len(s)):
        total = _pull(i, s, force, stiffness, swing, hung)
        if len(centre) > 0:
            if i % each == 0:
                away = _from_centre(s, i, centre)
            total += away * (s[i] - centre[i % each])
        pull += total * total
        into += total * floor[i]
    return pull - max(into, 0.0) ** 2 <= dry * dry


@part
def step(
    s: np.ndarray,
    v: np.ndarray,
    h: float,
    law: tuple,
    work: np.ndarray,
) -> None:
    """One Runge-Kutta step from ``s``, ``v`` into ``work[8]``, ``work[9]``."""
    steady, ramp, stiffness, swing, friction, apart, rods, centre, hung, floor = law
    force = work[10]
    for i in range(len(s)):
        force[i] = steady[i]
    a1, a2, a3, a4 = work[0], work[1], work[2], work[3]
    s2, v2, v3 = work[4], work[5], work[6]
    _accelerate(s, v, force, stiffness, swing, friction, apart, rods, centre, hung, floor, a1)
    for i in range(len(s)):
        s2[i] = s[i] + 0.5 * h * v[i]
        v2[i] = v[i] + 0.5 * h * a1[i]
        force[i] = steady[i] + 0.5 * h * ramp[i]
    _accelerate(s2, v2, force, stiffness, swing, friction, apart, rods, centre, hung, floor, a2)
    for i in range(len(s)):
        s2[i] = s[i] + 0.5 * h * v2[i]
        v3[i] = v[i] + 0.5 * h * a2[i]
    _accelerate(s2, v3, force, stiffness, swing, friction, apart, rods, centre, hung, floor, a3)
    v4 = work[7]
    for i in range(len(s)):
        s2[i] = s[i] + h * v3[i]
        v4[i] = v[i] + h * a3[i]
        force[i] = steady[i] + h * ramp[i]
    _accelerate(s2, v4, force, stiffness, swing, friction, apart, rods, centre, hung, floor, a4)
    for i in range(len(s)):
        work[8, i] = s[i] + h / 6 * (v[i] + 2 * v2[i] + 2 * v3[i] + v4[i])
        work[9, i] = v[i] + h / 6 * (a1[i] + 2 * a2[i] + 2 * a3[i] + a4[i])
