"""Whether a coordinate whose unit is not told is an angle, by how it moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms.choose import roughly
from vidphys.diagnose.mechanisms.frames import frames_of, thinned_to
from vidphys.diagnose.mechanisms.mechanism import MOST_CLIPS, thinned
from vidphys.diagnose.recordings.motion import Motion

UNITS = {"radians": 1.0, "degrees": np.pi / 180}
NARROWEST, WIDEST = 0.5, 2 * np.pi  # radians, that a swing goes through from end to end
ENOUGH = 250  # frames of a clip, that tell the two apart
LEFT = 0.5  # of what a spring's law leaves: a pendulum's leaves no more where it is an angle


def turns_in(motion: Motion) -> str:
    """The unit in which a lone coordinate moves as a pendulum's angle; empty where it does not.

    A pendulum's force goes with the sine of its angle, so a wide swing tells angles from places and
    radians from degrees. A spring's law must be clearly worse.

    Args:
        motion: of a coordinate whose unit is not known.
    """
    if motion.bodies > 1 or motion.space > 1 or motion.clips > MOST_CLIPS:
        return ""
    few = thinned(motion)
    return next((unit for unit in UNITS if _swings(turned(few, unit))), "")


def turned(motion: Motion, unit: str) -> Motion:
    """The same in radians."""
    return replace(motion, positions=UNITS[unit] * motion.positions)


def _swings(motion: Motion) -> bool:
    extent = np.nanmax(motion.positions) - np.nanmin(motion.positions)
    if not NARROWEST < extent < WIDEST:
        return False
    fits = roughly(thinned_to(frames_of(motion.of([0])), ENOUGH), angles=True)
    swings = [x for x in fits if x.model.law.restoring == "pendulum" and x.holds]
    springs = [x for x in fits if x.model.law.restoring == "trap"]
    least, spring = (min((x.left for x in some), default=np.inf) for some in (swings, springs))
    return bool(swings) and least < LEFT * spring
