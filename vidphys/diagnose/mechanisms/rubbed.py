"""A body that dry friction alone slows, until it rests; no friction with the speed is like it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.fit import race
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import Local, halves, joined, seen_in, start_of


def rubbed(clips: Sequence[Frames]) -> list[Fit]:
    """The law of a body that nothing pushes and dry friction slows.

    Args:
        clips: of the body; no law where inputs are known, or where it gets no slower.
    """
    if clips[0].inputs is not None:
        return []
    places = [clip.stretches[0].places for clip in clips]
    space = places[0].shape[1]
    each = [seen_in(clips, places, half) for half in halves(clips)]
    begun = [np.concatenate([[_slowing(x)], *map(start_of, x)]) for x in each if _slowing(x) > 0]
    model = Model(Law(space, "none", "dry"), (Plane(space),))
    return race(clips, [(model, begun)]) if begun else []


def _slowing(seen: Sequence[Local]) -> float:
    """How much speed is lost a second, while it moves."""
    v, a = joined(seen, "va")
    return float(-(a * v).sum() / max(np.linalg.norm(v, axis=-1).sum(), np.finfo(float).tiny))
