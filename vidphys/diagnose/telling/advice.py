"""What suffices: time step, integrator and frame rate for a scene whose terms are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PHASE = 0.1  # radians of the fastest oscillation in a step of leapfrog: energy errors near 1e-3
SEEN = 1.0  # radians of it between frames, up to which every oscillation is seen


@dataclass(frozen=True)
class Advice:
    """Sizes for rolling and for recording the scene.

    Args:
        fastest: rate of the stiffest motion that occurred, radians per second.
        dt: seconds, a step of leapfrog that follows it.
        integrator: of :data:`dynamics.INTEGRATORS`.
        frame_interval: seconds, at most, between frames that still show it.
        enough_frames: whether the recording had them.
        measured: sentences on what was measured to suffice, see
            :func:`vidphys.diagnose.telling.sufficient.with_measured`.
    """

    fastest: float
    dt: float
    integrator: str
    frame_interval: float
    enough_frames: bool
    measured: tuple[str, ...] = ()


def suffices(fastest: float, interval: float) -> Advice:
    """Sizes by rule.

    Args:
        fastest: rate of the stiffest motion that occurred, radians per second.
        interval: seconds between the frames of the recording.
    """
    if fastest <= 0:
        return Advice(0.0, interval, "leapfrog", np.inf, True)
    dt, frames = PHASE / fastest, SEEN / fastest
    return Advice(fastest, dt, "leapfrog", frames, bool(interval <= frames))
