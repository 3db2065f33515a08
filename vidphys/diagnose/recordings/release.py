"""Bodies that something holds, when a recording begins or in the middle of it, as a hand does.

A hand is a constraint that ends, not a force of the scene. What is recorded before it lets go says
nothing of the law and contradicts every model of it.
"""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion
from vidphys.diagnose.recordings.noise import measure_noise

FEWEST = 4  # frames in a row that show a body held
SURE = 3  # frames in a row that show it moved
STILL = 4.0  # times the noise of a position, within which a body has not moved
HELD = 12  # frames in a row that show it held after it has moved
FAR = 0.2  # of the size of the motion, that it then goes at least
SUDDEN = 3.0  # times farther than from rest a body is after twice the frames, if it was held


def free_frames(motion: Motion) -> tuple[int, int]:
    """First frame in which bodies are seen that nothing holds, and the one after the last.

    Where something holds them in the middle, it is the longest part without.
    """
    first, last = motion.shown()
    begin = first + held_until(motion.cut(first, last))
    holds = held_within(motion.cut(begin, last)) if motion.clips == 1 else []
    starts = [begin, *(begin + stop for _, stop in holds)]
    stops = [*(begin + start for start, _ in holds), last]
    return max(zip(starts, stops, strict=True), key=lambda part: part[1] - part[0])


def held_within(motion: Motion) -> list[tuple[int, int]]:
    """First frame of each hold of a moving body, and the one in which it is let go."""
    path, near = motion.positions[0], STILL * measure_noise(motion).sigma
    far, holds = FAR * float(np.nanmax(np.nanmax(path, 0) - np.nanmin(path, 0))), []
    start = FEWEST
    while start < len(path) - HELD - LEAST_FRAMES:
        away = np.linalg.norm(path[start:] - path[start], axis=-1)
        away = np.where(np.isfinite(away), away, np.inf).max(-1)
        still = int((away > near).argmax())
        later = min(2 * still, len(away) - 1)
        gone = away[still : later + 1]
        gone = gone[np.isfinite(gone)].max(initial=0.0)
        if still >= HELD and gone > max(far, SUDDEN * near * (later / (still - 1)) ** 2):
            holds.append((start, start + still))
        start += max(still, 1)
    return holds


def held_until(motion: Motion) -> int:
    """First frame in which a body has moved, after all were held still; 0 where none was.

    A body that starts from rest under a steady force is at most four times as far within twice the
    time. Only one that was held for longer than it then takes to be seen moving is ``SUDDEN``
    times farther than that.

    Args:
        motion: clips whose bodies are let go at the same frame, as is the case with one clip.
    """
    first_place = motion.positions[:, :FEWEST].mean(1, keepdims=True)
    away = np.nan_to_num(np.linalg.norm(motion.positions - first_place, axis=-1)).max((0, 2))
    near = STILL * measure_noise(motion).sigma
    in_a_row = np.lib.stride_tricks.sliding_window_view(away, SURE)  # one may be an outlier
    moved = in_a_row.min(1) > near
    first = int(moved.argmax())
    if not FEWEST <= first <= len(moved) - LEAST_FRAMES:
        return 0
    later = min(2 * first, len(away) - 1)
    from_rest = near * (later / (first - 1)) ** 2  # it was still near in the frame before
    return first if away[first : later + 1].max() > SUDDEN * from_rest else 0
