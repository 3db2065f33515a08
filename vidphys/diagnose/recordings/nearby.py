"""Places that are counted from far away, as those of a map: told from near where things move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vidphys.diagnose.recordings.motion import Motion

FAR = 100.0  # times what the bodies move in, from which rounding in a fit grows with the distance


def from_nearby(motion: Motion) -> tuple[Motion, np.ndarray | None]:
    """The motion counted from a round place in its middle, and that place ``(d,)``.

    Args:
        motion: tracks.

    Returns:
        The motion as it is and ``None``, where it is near its origin.
    """
    places = motion.positions[motion.seen]
    if not len(places):
        return motion, None
    middle, extent = places.mean(0), float(np.ptp(places, axis=0).max())
    if not 0 < extent * FAR < np.abs(middle).max():
        return motion, None
    round_to = 10.0 ** np.floor(np.log10(extent))
    place = round_to * np.round(middle / round_to)
    return replace(motion, positions=motion.positions - place), place
