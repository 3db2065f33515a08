"""A law of one coordinate rolled in compiled loops, with its derivatives by its own numbers.

The force is looked up in a table, and so are its derivatives by each of its numbers; what goes with
the speed is one of a few words. Steps are fourth-order Runge-Kutta; the derivatives of a path are
stepped beside it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from loops import kernel, part

# words of the speed, by their number below; two of them change with the place
SPEEDS = ("v", "v |v|", "sgn(v)", "v^3", "x v", "x^2 v")


@part
def _looked_up(
    table: np.ndarray,
    low: float,
    step: float,
    x: float,
    out: np.ndarray,
) -> float:
    """All columns at ``x`` into ``out``, by the cubic through four rows; the first one's slope.

    Beyond the table its ends go on.
    """
    rows, columns = table.shape
    at = (x - low) / step
    inside = at >= 1.0 and at <= rows - 2.0
    at = min(max(at, 1.0), rows - 2.0 - 1e-9)
    first = int(at)
    u = at - first
    w0, w1 = -u * (u - 1) * (u - 2) / 6, (u + 1) * (u - 1) * (u - 2) / 2
    w2, w3 = -(u + 1) * u * (u - 2) / 2, (u + 1) * u * (u - 1) / 6
    for k in range(columns):
        out[k] = (
            w0 * table[first - 1, k]
            + w1 * table[first, k]
            + w2 * table[first + 1, k]
            + w3 * table[first + 2, k]
        )
    if not inside:
        return 0.0
    d0, d1 = -(3 * u * u - 6 * u + 2) / 6, (3 * u * u - 4 * u - 1) / 2
    d2, d3 = -(3 * u * u - 2 * u - 2) / 2, (3 * u * u - 1) / 6
    slope = (
        d0 * table[first - 1, 0]
        + d1 * table[first, 0]
        + d2 * table[first + 1, 0]
        + d3 * table[first + 2, 0]
    )
    return slope / step


@part
def _word(
    code: int,
    x: float,
    v: float,
) -> tuple[float, float, float]:
    """A word of the speed, and its slopes by the speed and by the place."""
    if code == 0:
        return v, 1.0, 0.0
    if code == 1:
        return v * abs(v), 2 * abs(v), 0.0
    if code == 2:
        return float(np.sign(v)), 0.0, 0.0
    if code == 3:
        return v * v * v, 3 * v * v, 0.0
    if code == 4:
        return x * v, x, v
    return x * x * v, x * x, 2 * x * v


@part
def _accelerate(
    state: np.ndarray,
    law: tuple,
    row: np.ndarray,
    out: np.ndarray,
) -> None:
    """The rate of ``state`` ``(2, 1 + numbers + 2)``: path and derivatives, then their rates."""
    table, low, step, codes, drags = law
    words, forces = len(codes), table.shape[1] - 1
    x, v = state[0, 0], state[1, 0]
    slope = _looked_up(table, low, step, x, row)
    total, rate = row[0], 0.0
    for k in range(words):
        value, by_v, by_x = _word(codes[k], x, v)
        total += drags[k] * value
        rate += drags[k] * by_v
        slope += drags[k] * by_x
        row[1 + forces + k] = value
    out[0, 0], out[1, 0] = v, total
    for k in range(1, state.shape[1]):
        out[0, k] = state[1, k]
        forced = row[k] if k <= forces + words else 0.0
        out[1, k] = slope * state[0, k] + rate * state[1, k] + forced


@part
def _moved(
    state: np.ndarray,
    rate: np.ndarray,
    h: float,
    out: np.ndarray,
) -> None:
    for i in range(2):
        for k in range(state.shape[1]):
            out[i, k] = state[i, k] + h * rate[i, k]


@kernel
def _rolled(
    times: np.ndarray,
    starts: np.ndarray,
    law: tuple,
    substeps: int,
    out: np.ndarray,
) -> None:
    pieces, frames = times.shape
    wide = out.shape[2]
    row, work = np.zeros(wide), np.zeros((6, 2, wide))
    state, tried = work[0], work[1]
    for p in range(pieces):
        state[:] = 0.0
        state[0, 0], state[1, 0] = starts[p, 0], starts[p, 1]
        state[0, wide - 2], state[1, wide - 1] = 1.0, 1.0
        out[p, 0] = state[0]
        for frame in range(1, frames):
            h = (times[p, frame] - times[p, frame - 1]) / substeps
            for _ in range(substeps):
                _accelerate(state, law, row, work[2])
                _moved(state, work[2], 0.5 * h, tried)
                _accelerate(tried, law, row, work[3])
                _moved(state, work[3], 0.5 * h, tried)
                _accelerate(tried, law, row, work[4])
                _moved(state, work[4], h, tried)
                _accelerate(tried, law, row, work[5])
                _moved(state, work[2], h / 6, state)
                _moved(state, work[3], h / 3, state)
                _moved(state, work[4], h / 3, state)
                _moved(state, work[5], h / 6, state)
            out[p, frame] = state[0]
        out[p, frames] = state[1]


def rolled(
    times: Float[np.ndarray, "p t"],
    starts: Float[np.ndarray, "p 2"],
    table: Float[np.ndarray, "m columns"],
    low: float,
    step: float,
    speeds: tuple[str, ...],
    drags: Float[np.ndarray, " s"],
    substeps: int,
) -> Float[np.ndarray, "p frames wide"]:
    """Paths of pieces and their derivatives.

    Args:
        times: seconds of each piece's frames.
        starts: place and speed at the first.
        table: force, and its derivatives by its numbers, at places ``low + k step``.
        speeds: words of the speed, of :data:`SPEEDS`.
        drags: their coefficients.
        substeps: of a frame interval.

    Returns:
        ``(p, t + 1, 1 + numbers + 2)``: places at all frames and at last the speed; after each its
        derivatives by the force's numbers, the drags, and the start.
    """
    wide = table.shape[1] + len(drags) + 2
    out = np.empty((len(times), times.shape[1] + 1, wide))
    codes = np.array([SPEEDS.index(word) for word in speeds], np.int64)
    law = (np.ascontiguousarray(table), float(low), float(step), codes, np.asarray(drags, float))
    _rolled(times, np.ascontiguousarray(starts), law, substeps, out)
    return out
