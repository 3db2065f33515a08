"""Bodies that rest while others move: the mark of a pivot, or what was left in view."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.recordings.motion import Motion
from vidphys.statistics import noise_of

SMALL = 0.02  # of the way of what goes farthest, that what rests seems to go
NOISY = 1.5  # times its noise, that this is at most: what drifts, or is pulled, goes smoothly


def without_resting(motion: Motion) -> tuple[Motion, tuple[str, ...]]:
    """The motion without the bodies that show nothing but noise, where another moves.

    Args:
        motion: of a table.

    Returns:
        It, and what a person should know.
    """
    ways = np.array([_way(motion, body) for body in range(motion.bodies)])
    small = ways < SMALL * np.nanmax(ways)
    rest = [k for k in range(motion.bodies) if small[k] and _is_noise(motion, k)]
    if not rest:
        return motion, ()
    moving = [body for body in range(motion.bodies) if body not in rest]
    *some, last = (str(body + 1) for body in rest)
    rests = f"bodies {', '.join(some)} and {last} rest" if some else f"body {last} rests"
    return motion.of(moving), (f"{rests} while others move: left out, and the others counted anew",)


def _shown(motion: Motion, body: int) -> list[np.ndarray]:
    """Its places ``(t, d)`` in the frames of each clip in which it is seen."""
    seen = motion.seen[:, :, body]
    each = zip(motion.positions, seen, strict=True)
    return [places[s, body] for places, s in each if s.any()]


def _way(motion: Motion, body: int) -> float:
    """How far it goes at most in a clip, by its spread; NaN where it is not seen."""
    return max((np.ptp(x, axis=0).max() for x in _shown(motion, body)), default=np.nan)


def _is_noise(motion: Motion, body: int) -> bool:
    axes = [axis for places in _shown(motion, body) for axis in places.T]
    return all(axis.std() <= NOISY * noise_of(axis) for axis in axes)
