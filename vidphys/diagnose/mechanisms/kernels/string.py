"""A weight on a string that may go slack, stepped in compiled loops.

While the string is taut the weight keeps its distance from a fixed place, and the string takes
what would pull it away. Where that would have to push, it is slack and the weight falls freely,
until it is at the string's end again: then the string takes what speed there is along it. Steps
are fourth-order Runge-Kutta.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from loops import kernel, part

TAUT = 0.999  # of its length, from which a string is taken for taut when the motion begins


@part
def _distance(s: np.ndarray, string: np.ndarray) -> float:
    square = 0.0
    for i in range(len(s)):
        square += (s[i] - string[i]) ** 2
    return np.sqrt(square)


@part
def _pull(v: np.ndarray, away: np.ndarray, force: np.ndarray, rate: float, length: float) -> float:
    """What a taut string takes, along it."""
    along, square = 0.0, 0.0
    for i in range(len(v)):
        along += (force[i] - rate * v[i]) * away[i]
        square += v[i] * v[i]
    return (along + square) / length


@part
def _accelerate(
    s: np.ndarray,
    v: np.ndarray,
    string: np.ndarray,
    force: np.ndarray,
    rate: float,
    taut: bool,
    away: np.ndarray,
    out: np.ndarray,
) -> None:
    for i in range(len(s)):
        away[i] = s[i] - string[i]
        out[i] = force[i] - rate * v[i]
    if taut:
        far = _distance(s, string)
        pull = _pull(v, away, force, rate, far)
        for i in range(len(s)):
            out[i] -= pull * away[i] / far


@part
def _step(
    s: np.ndarray,
    v: np.ndarray,
    h: float,
    string: np.ndarray,
    force: np.ndarray,
    rate: float,
    taut: bool,
    work: np.ndarray,
) -> None:
    """One Runge-Kutta step from ``s``, ``v`` into ``work[6]``, ``work[7]``."""
    a, s2, v2, away = work[:4], work[4], work[5], work[8]
    ds, dv = work[9], work[10]
    _accelerate(s, v, string, force, rate, taut, away, a[0])
    for i in range(len(s)):
        ds[i], dv[i] = v[i], a[0, i]
    for stage in range(1, 4):
        share = 1.0 if stage == 3 else 0.5
        weight = 1.0 if stage == 3 else 2.0
        for i in range(len(s)):
            before = v[i] if stage == 1 else v2[i]
            s2[i] = s[i] + share * h * before
        for i in range(len(s)):
            v2[i] = v[i] + share * h * a[stage - 1, i]
        _accelerate(s2, v2, string, force, rate, taut, away, a[stage])
        for i in range(len(s)):
            ds[i] += weight * v2[i]
            dv[i] += weight * a[stage, i]
    for i in range(len(s)):
        work[6, i] = s[i] + h / 6 * ds[i]
        work[7, i] = v[i] + h / 6 * dv[i]


@part
def _tighten(s: np.ndarray, v: np.ndarray, string: np.ndarray) -> None:
    """Put the weight at the string's end, and take its speed along it."""
    far, along = _distance(s, string), 0.0
    for i in range(len(s)):
        along += v[i] * (s[i] - string[i]) / far
    for i in range(len(s)):
        out = (s[i] - string[i]) / far
        s[i] = string[i] + string[-1] * out
        v[i] -= along * out


@kernel
def _swung(
    times: np.ndarray,
    string: np.ndarray,
    force: np.ndarray,
    rate: float,
    most: float,
    out: np.ndarray,
) -> None:
    s, v, work = out[0, 0].copy(), out[0, 1].copy(), np.zeros((11, out.shape[2]))
    taut = _distance(s, string) >= TAUT * string[-1]
    if taut:
        _tighten(s, v, string)
    for frame in range(1, len(times)):
        gap = times[frame] - times[frame - 1]
        count = int(np.ceil(gap / most))
        for _ in range(count):
            h = gap / count
            _step(s, v, h, string, force, rate, taut, work)
            before, after = _distance(s, string), _distance(work[6], string)
            if not taut and after > string[-1]:
                share = (string[-1] - before) / max(after - before, 1e-300)
                _step(s, v, share * h, string, force, rate, False, work)
                s[:], v[:] = work[6], work[7]
                _tighten(s, v, string)
                taut = True
                _step(s, v, (1 - share) * h, string, force, rate, True, work)
            s[:], v[:] = work[6], work[7]
            if taut:
                _tighten(s, v, string)
                for i in range(len(s)):
                    work[8, i] = s[i] - string[i]
                taut = _pull(v, work[8], force, rate, string[-1]) >= 0.0
        out[frame, 0], out[frame, 1] = s, v


def swung(
    times: Float[np.ndarray, " t"],
    start: Float[np.ndarray, "2 d"],
    string: Float[np.ndarray, " d+1"],
    force: Float[np.ndarray, " d"],
    rate: float,
    most: float,
) -> Float[np.ndarray, "t 2 d"]:
    """Places in the plane or in space, and velocities, at each time.

    Args:
        times: seconds, increasing; the start is at the first.
        start: place and velocity.
        string: where it hangs, and its length.
        force: steady acceleration.
        rate: of the friction that goes with the speed, per second.
        most: seconds of a step at most.
    """
    out = np.empty((len(times), *start.shape))
    out[0] = start
    _swung(times, string, force, rate, most, out)
    return out
