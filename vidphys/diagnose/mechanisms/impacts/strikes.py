"""Bodies that something strikes which is not seen: a wall, a floor, a hand."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.mechanisms.impacts.kinks import Impact, find_impacts
from vidphys.diagnose.recordings.motion import Motion

MEETING = 2.0  # sides of a kink, within which another body that comes nearest may have struck


def strikes(motion: Motion) -> list[tuple[int, float]]:
    """Bodies, and the seconds at which something unseen strikes them, in any clip.

    Args:
        motion: of few bodies; their impacts on each other are not told.
    """
    found = []
    for path, seen, times in zip(motion.positions, motion.seen, motion.times, strict=True):
        for body in range(motion.bodies):
            at = np.flatnonzero(seen[:, body])
            if len(at) < 3:
                continue
            found += [
                (body, float(times[at[x.frame]]))
                for x in find_impacts(times[at], path[at, body])
                if not _met(path, body, int(at[x.frame]), x)
            ]
    return sorted(found)


def _met(path: np.ndarray, body: int, frame: int, impact: Impact) -> bool:
    """Whether another body comes nearest at an impact, or was not seen then."""
    reach = int(np.ceil(MEETING * impact.side))
    first = max(frame - reach, 0)
    others = np.delete(path[first : frame + reach + 1], body, axis=1)
    for other in others.transpose(1, 0, 2):
        apart = np.linalg.norm(other - path[first : frame + reach + 1, body], axis=-1)
        if not np.isfinite(apart).any():
            return True
        nearest = int(np.nanargmin(apart)) - (frame - first)
        if abs(nearest) <= impact.side:
            return True
    return False
