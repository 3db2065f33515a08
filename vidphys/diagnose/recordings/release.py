"""Bodies that something holds when a recording begins: a hand that has yet to let go.

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
SUDDEN = 3.0  # times farther than from rest a body is after twice the frames, if it was held


def free_frames(motion: Motion) -> tuple[int, int]:
    """First frame in which bodies are seen that nothing holds, and the one after the last."""
    first, last = motion.shown()
    return first + held_until(motion.cut(first, last)), last


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
