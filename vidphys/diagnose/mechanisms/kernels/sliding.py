"""A body that slides along a curve under a steady force, stepped in compiled loops.

With the length s along the curve, its tangent t, its normal n to the left, its curvature k and
v = ds/dt,

    dv/dt = force.t - linear v - square |v| v - share |k v^2 - force.n| v/|v|

where the last is dry friction: a share of what presses the body to the curve. It rests where it
turns round and friction holds it. Steps are fourth-order Runge-Kutta.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from loops import kernel, part


@part
def _pulls(s: float, force: np.ndarray, table: np.ndarray, spacing: float) -> tuple:
    """The force along the curve and to the left of it, and the curvature, at a length."""
    at = min(max(s / spacing, 0.0), len(table) - 1.0)
    first = min(int(at), len(table) - 2)
    share = at - first
    x = (1 - share) * table[first, 0] + share * table[first + 1, 0]
    y = (1 - share) * table[first, 1] + share * table[first + 1, 1]
    bend = (1 - share) * table[first, 2] + share * table[first + 1, 2]
    if s < 0.0 or s > (len(table) - 1) * spacing:  # beyond its ends it goes straight on
        bend = 0.0
    return force[0] * x + force[1] * y, force[1] * x - force[0] * y, bend


@part
def _accelerate(
    s: float, v: float, force: np.ndarray, friction: np.ndarray, table: np.ndarray, spacing: float
) -> float:
    along, left, bend = _pulls(s, force, table, spacing)
    lost = friction[0] * v + friction[1] * abs(v) * v
    if v != 0.0:
        lost += friction[2] * abs(bend * v * v - left) * (1.0 if v > 0.0 else -1.0)
    return along - lost


@kernel
def _slid(
    times: np.ndarray,
    force: np.ndarray,
    friction: np.ndarray,
    table: np.ndarray,
    spacing: float,
    most: float,
    out: np.ndarray,
) -> None:
    s, v = out[0, 0, 0], out[0, 1, 0]
    for frame in range(1, len(times)):
        gap = times[frame] - times[frame - 1]
        count = int(np.ceil(gap / most))
        h = gap / count
        for _ in range(count):
            a1 = _accelerate(s, v, force, friction, table, spacing)
            v2 = v + 0.5 * h * a1
            a2 = _accelerate(s + 0.5 * h * v, v2, force, friction, table, spacing)
            v3 = v + 0.5 * h * a2
            a3 = _accelerate(s + 0.5 * h * v2, v3, force, friction, table, spacing)
            v4 = v + h * a3
            a4 = _accelerate(s + h * v3, v4, force, friction, table, spacing)
            # By the last look ahead: friction that turns round hides the rest.
            if v4 * v <= 0.0 and friction[2] > 0.0:
                along, left, _bend = _pulls(s, force, table, spacing)
                if abs(along) <= friction[2] * abs(left):
                    v = 0.0
                    break
            s += h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        out[frame, 0, 0], out[frame, 1, 0] = s, v


def slid(
    times: Float[np.ndarray, " t"],
    start: Float[np.ndarray, "2 1"],
    force: Float[np.ndarray, " 2"],
    friction: Float[np.ndarray, " 3"],
    table: Float[np.ndarray, "n 3"],
    spacing: float,
    most: float,
) -> Float[np.ndarray, "t 2 1"]:
    """Lengths along a curve and their rates at each time.

    Args:
        times: seconds, increasing; the start is at the first.
        start: length and rate.
        force: steady acceleration in the plane.
        friction: the linear rate, the square one, and the share of what presses it to the curve.
        table: tangent and curvature, positive to the left, evenly along the curve.
        spacing: of the table's rows, along the curve.
        most: seconds of a step at most.
    """
    out = np.empty((len(times), 2, 1))
    out[0] = start
    _slid(times, force, friction, table, spacing, most, out)
    return out
