"""Places that are exact, as a simulation writes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vidphys.diagnose.recordings.motion import Motion, Unseen
from vidphys.diagnose.recordings.noise import measure_noise

FINEST = 1e-5  # of the spread: the noise of a fine instrument


def as_measured(motion: Motion) -> tuple[Motion, float]:
    """The motion with the noise of a fine instrument, where it has less, and that noise, or 0.

    What is finer is rounding and the errors of whatever integrated the motion. No law explains
    these, so that friction or a drive would seem to, and no formula would be good enough.
    """
    noise = FINEST * float(np.nanmax(np.nanstd(motion.positions, axis=1)))
    try:
        if measure_noise(motion).sigma >= noise:
            return motion, 0.0
    except Unseen:
        return motion, 0.0
    shaken = np.random.default_rng(0).normal(size=motion.positions.shape) * noise
    return replace(motion, positions=motion.positions + shaken), noise
