"""What suffices: time step, integrator and frame rate for a scene whose terms are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import Field, field_of
from vidphys.diagnose.inference.structures import Structure

PHASE = 0.1  # radians of the fastest oscillation in a step of leapfrog: energy errors near 1e-3
SEEN = 1.0  # radians of it between frames, up to which every oscillation is seen
NUDGE = 1e-4


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


def advise(inference: Inference, interval: float) -> Advice:
    """Advice from the stiffest place that the bodies came through.

    Args:
        inference: the terms and the paths.
        interval: seconds between the frames of the recording.
    """
    field = field_of(inference.windows, inference.fitted.paths)
    return suffices(stiffest(field, inference.structure), interval)


def suffices(fastest: float, interval: float) -> Advice:
    """Advice from the rate of the stiffest motion, radians per second."""
    if fastest <= 0:
        return Advice(0.0, interval, "leapfrog", np.inf, True)
    dt, frames = PHASE / fastest, SEEN / fastest
    return Advice(fastest, dt, "leapfrog", frames, bool(interval <= frames))


def stiffest(field: Field, structure: Structure) -> float:
    """The fastest rate of the linearised motion over all places, radians per second."""
    count, nodes, bodies, space = field.q.shape
    a = structure.accelerations(field)
    step = NUDGE * float(field.q.std() or 1.0)
    slopes = np.zeros((count, nodes, bodies * space, bodies * space))
    for body in range(bodies):
        for axis in range(space):
            q = field.q.copy()
            q[:, :, body, axis] += step
            moved = Field(q, field.v, field.t, field.mass, field.strength)
            change = (structure.accelerations(moved) - a) / step
            slopes[..., body * space + axis] = change.reshape(count, nodes, -1)
    if not np.isfinite(slopes).all():
        return 0.0
    return float(np.sqrt(np.abs(np.linalg.eigvals(slopes)).max()))
