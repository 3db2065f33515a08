"""A body that flies and is seen to spin, which the air pushes across its way (Magnus effect)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.fit import race
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import halves, seen_in, start_of

FRICTIONS = ("none", "linear", "square")  # of the air
FLAT = 2  # dimensions of the plane


def lifted(clips: Sequence[Frames]) -> list[Fit]:
    """Laws of a body under a constant acceleration and a lift that goes with its spin and speed.

    Args:
        clips: of the body; no laws unless it is seen to spin.
    """
    fades = clips[0].spin_fades
    if fades is None or len(clips) > 1:
        return []
    stretch = clips[0].stretches[0]
    runners = []
    for friction in FRICTIONS:
        law = Law(FLAT, "uniform", friction, lift_fades=fades)
        begun = []
        for half in halves(clips):
            (seen,) = seen_in(clips, [stretch.places], half)
            numbers = _regressed(seen.v, seen.a, friction, np.exp(-fades * seen.times))
            begun.append(np.concatenate([numbers, start_of(seen)]))
        runners.append((Model(law, (Plane(FLAT),)), begun))
    return race(clips, runners)


def _regressed(v: np.ndarray, a: np.ndarray, friction: str, spin: np.ndarray) -> np.ndarray:
    """The law's numbers by least squares: force, friction where there is one, and lift.

    Args:
        v, a: velocities and accelerations ``(t, 2)``.
        friction: of :data:`FRICTIONS`.
        spin: over that at first, ``(t,)``.
    """
    along = {"none": [], "linear": [-v], "square": [-v * np.linalg.norm(v, axis=-1)[:, None]]}
    across = spin[:, None] * np.column_stack([-v[:, 1], v[:, 0]])
    columns = [*(np.broadcast_to(axis, v.shape) for axis in np.eye(FLAT)), *along[friction], across]
    design = np.stack([column.ravel() for column in columns], 1)
    return np.linalg.lstsq(design, a.ravel(), rcond=None)[0]
