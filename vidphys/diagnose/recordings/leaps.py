"""Finds of something else: a body cannot leap to another place and go on from where it was."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

LEAP = 2.2  # times the fastest step around, from which a step is no step of the body
AROUND = 8  # steps before and after, that tell how fast it goes
FEWEST = 3  # of them, before as after
ONWARD = 1.5  # times that step's speed, at which it may go from before to after what is left out
GAP = 1.5  # usual intervals, from which frames lie between two finds
MOST = 16  # finds in a row that may be of something else


def without_leaps(
    positions: Float[np.ndarray, "t n d"], times: Float[np.ndarray, " t"]
) -> Float[np.ndarray, "t n d"]:
    """Places without those that a body would have to leap to.

    A few finds in a row are left out where a leap leads to them or from them, a leap or a gap is at
    their other end, and the frames before and after go on without them about as fast as the body
    does there.

    Args:
        positions: NaN where a body was not seen.
        times: seconds, increasing.

    Example:
        >>> path = np.linspace(0, 1, 20).reshape(-1, 1, 1)
        >>> path[9:11] = 5.0
        >>> np.flatnonzero(np.isnan(without_leaps(path, np.arange(20.0)))).tolist()
        [9, 10]
    """
    kept = positions.copy()
    for body in range(kept.shape[1]):
        seen = np.flatnonzero(np.isfinite(kept[:, body]).all(-1))
        left = _leaping(kept[seen, body], times[seen])
        kept[seen[left], body] = np.nan
    return kept


def _leaping(path: np.ndarray, times: np.ndarray) -> list[int]:
    """Finds ``(t, d)`` to which a body would have to leap."""
    speed, first = _speeds(path, times), FEWEST + 1
    left: list[int] = []
    while first < len(path):
        ends = range(first + 1, min(first + MOST, len(path) - FEWEST - 1) + 1)
        stop = next((k for k in ends if _apart(path, times, speed, first, k)), first)
        left += range(first, stop)
        first = max(first, stop) + 1
    return left


def _apart(path: np.ndarray, times: np.ndarray, speed: np.ndarray, first: int, stop: int) -> bool:
    """Whether the finds from ``first`` up to ``stop`` are of something else."""
    around = [speed[max(first - 1 - AROUND, 0) : first - 1], speed[stop : stop + AROUND]]
    usual = float(np.concatenate(around).max())
    sides, ends = [first - 1, stop - 1], [first - 1, stop]
    gaps = np.diff(times)[sides] > GAP * np.median(np.diff(times))
    leaps = speed[sides] > LEAP * usual
    goes_on = _speeds(path[ends], times[ends])[0] <= ONWARD * usual
    return bool(goes_on and leaps.any() and (gaps | leaps).all())


def _speeds(path: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Of each step, unit of the places per second."""
    return np.linalg.norm(np.diff(path, axis=0), axis=-1) / np.diff(times)
