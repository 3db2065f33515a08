"""A hand with its arm, as it holds a body at the origin from the side of +x."""

from __future__ import annotations

import numpy as np

from vidphys.experiments.filmed.props.pieces import Piece, between
from vidphys.experiments.filmed.scenes.scene import Held

OPENS = 0.3  # seconds in which it draws back
DRAWS_BACK = 0.14  # metres
SWAY = 0.006  # metres


def hand(radius: float) -> list[Piece]:
    """The pieces; fingers close around a body of this radius, metres."""
    r = max(radius, 0.02)
    knuckles = np.array([r + 0.055, 0.015, 0.012])
    pieces = [
        Piece("ellipsoid", (0.052, 0.042, 0.022), "skin", np.array([r + 0.085, 0.015, 0.0])),
        between((r + 0.12, 0.015, 0.0), (r + 0.42, 0.03, -0.04), 0.031, "skin"),
        between((r + 0.26, 0.02, -0.02), (r + 0.75, 0.05, -0.09), 0.047, "cloth"),
    ]
    for k, side in enumerate((-0.03, -0.01, 0.01, 0.03)):  # index to little finger
        start = knuckles + [0, side, 0]
        bend = np.array([0.35 * r, side * 0.9 + 0.012, r * 0.9 + 0.012 - 0.004 * k])
        tip = np.array([-0.35 * r, side * 0.8 + 0.012, r * 0.95])
        pieces += [between(start, bend, 0.009, "skin"), between(bend, tip, 0.008, "skin")]
    thumb = np.array([r + 0.05, -0.02, -0.012]), np.array([0.1 * r, -0.01, -r - 0.006])
    return [*pieces, between(*thumb, 0.011, "skin")]


def course(held: Held, starts: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Places ``(t, 2)`` of the hand's grip in the plane of motion.

    Args:
        held: who lets go of what.
        starts: places ``(t, 2)`` of the body, of which the hand follows those before the release.
        times: seconds of the clip.
    """
    since = np.maximum(times - held.seconds, 0.0)
    share = np.minimum(since / OPENS, 1.0)
    back = DRAWS_BACK * share**2 * (3 - 2 * share)
    way = np.array(held.way) / np.hypot(*held.way)
    places = starts + way * back[:, None]
    thrown = np.array(held.velocity)
    slows = np.minimum(since, OPENS)
    places = places + thrown * (slows - slows**2 / (2 * OPENS))[:, None] * 0.35
    sway = np.stack([np.sin(2.1 * since), np.sin(1.7 * since + 0.5) - np.sin(0.5)], -1)
    return places + SWAY * sway


def axes(held: Held) -> np.ndarray:
    """The hand's own, so that its arm goes the way that it holds the body from."""
    x, z = np.array(held.way) / np.hypot(*held.way)
    first = np.array([x, 0.0, z])
    across = np.array([0.0, 1.0, 0.0])
    return np.stack([first, across, np.cross(first, across)], 1)
