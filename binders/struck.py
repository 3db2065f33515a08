"""Whether two things strike each other: where they meet, each is pushed away from the other."""

from __future__ import annotations

import numpy as np

from binders.hypotheses import Hypothesis

BESIDE = 6  # frames before they meet and after, that tell how fast each goes
AT_ONE = 2  # frames beside that in which they are nearest, in which they may be seen as one
NEAR = 1.5  # times the sum of their sizes, within which they meet: rims may be dull
PUSHED = 0.15  # of the speed at which they come together, that each is changed by at least
STRAIGHT = 0.1  # of the way in these frames, and a pixel, by which each may be off a straight line


def strike(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether they come together, and each goes straight before it and after, another way.

    A thing and its shadow, or a hand and what it holds, do not push each other apart.
    """
    apart = np.linalg.norm(one.positions - other.positions, axis=-1)
    if not np.isfinite(apart).any():
        return False
    meet = int(np.nanargmin(apart))
    last = meet - AT_ONE - 1  # frame before they meet
    if last < BESIDE or not 0 < apart[last] < NEAR * (one.usual_size + other.usual_size):
        return False
    before, after = slice(last + 1 - BESIDE, last + 1), slice(meet + AT_ONE + 1, None)
    speeds = [_speed(body, part) for part in (before, after) for body in (one, other)]
    if any(speed is None for speed in speeds):
        return False
    first, second, later, late = np.array(speeds)
    away = (one.positions[last] - other.positions[last]) / apart[last]
    coming = (second - first) @ away
    pushes = min((later - first) @ away, (second - late) @ away)
    return bool(coming > 0 and pushes > PUSHED * coming)


def _speed(body: Hypothesis, part: slice) -> np.ndarray | None:
    """Pixels a frame, ``(2,)``; ``None`` where it does not go straight, or is not seen enough."""
    places = body.positions[part][:BESIDE]
    frames = np.flatnonzero(np.isfinite(places[:, 0]))
    if len(frames) < BESIDE - 1:
        return None
    line = np.polyfit(frames, places[frames], 1)
    off = places[frames] - frames[:, None] * line[0] - line[1]
    way = BESIDE * np.linalg.norm(line[0])
    return line[0] if np.abs(off).max() < 1.0 + STRAIGHT * way else None
