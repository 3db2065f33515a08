"""Pucks that glide without friction and meet: places of two discs on a table."""

from __future__ import annotations

import numpy as np

from vidphys.experiments.filmed.laws.law import Law


def _meet(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Straight lines up to the contact and after it; the discs are smooth, so spins stay."""
    ratio, restitution, reach, *rest = numbers
    places, speeds = np.array(rest[:4]).reshape(2, 2), np.array(rest[4:]).reshape(2, 2)
    when = contact(places[1] - places[0], speeds[1] - speeds[0], reach)
    straight = places + speeds * times[:, None, None]
    if when is None:
        return straight
    touch = places + speeds * when
    normal = (touch[1] - touch[0]) / reach
    closing = (speeds[1] - speeds[0]) @ normal
    push = -(1 + restitution) * closing / (1 + 1 / ratio)  # of a first mass of 1
    after = speeds + push * np.stack([-normal, normal / ratio])
    bent = touch + after * (times - when)[:, None, None]
    return np.where((times < when)[:, None, None], straight, bent)


def contact(between: np.ndarray, closing: np.ndarray, reach: float) -> float | None:
    """Seconds until two discs touch; ``None`` where they miss each other.

    Args:
        between: from the first to the second, metres, ``(2,)``.
        closing: velocity of the second as the first sees it, m/s.
        reach: sum of the radii, metres.
    """
    a, b, c = closing @ closing, between @ closing, between @ between - reach**2
    inside = b**2 - a * c
    if b >= 0 or inside < 0:
        return None
    return float((-b - np.sqrt(inside)) / a)


PUCKS = Law(
    ("mass_ratio", "restitution", "reach", "x1", "y1", "x2", "y2", "u1", "v1", "u2", "v2"), _meet
)
