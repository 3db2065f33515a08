"""A weight on a string or a rod from a fixed place, free to swing to all sides (a spherical
pendulum): where fits begin.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.fit import with_friction_or_none
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import halves, joined, seen_in, start_of

SPACE = 3
# extents of the path, by which a string hangs from beside it: all are as near to a shallow one
BESIDE = (-8.0, -4.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 4.0, 8.0)
BEST = 2  # places with which fits begin, beside the middle of the nearest sphere
VAGUE = 0.1  # of its length: a standard error from which it is not told
DEEP = 2.0  # times what is left, that a path on a sphere leaves a plane by at least


def spherical(clips: Sequence[Frames]) -> list[Fit]:
    """Laws of a body in space that a string keeps at one distance, in a steady field.

    Args:
        clips: of the body.
    """
    places = [clip.stretches[0].places for clip in clips]
    if places[0].shape[1] != SPACE or clips[0].inputs is not None:
        return []
    model = Model(Law(SPACE, "string", "linear"), (Plane(SPACE),))
    centres = _centres(np.concatenate(places))
    begun = []
    for half in halves(clips):
        seen = seen_in(clips, places, half)
        s, v, a = joined(seen, "sva")
        sphere, *beside = (_regressed(s, v, a, centre) for centre in centres)
        for numbers, _ in (sphere, *sorted(beside, key=lambda x: x[1])[:BEST]):
            begun.append(np.concatenate([numbers, *map(start_of, seen)]))
    return [x for x in with_friction_or_none(clips, [(model, begun)]) if _told(x)]


def _centres(places: np.ndarray) -> list[np.ndarray]:
    """Where a string may hang: the middle of the nearest sphere, and places beside a flat path."""
    middle = places.mean(0)
    away = places - middle
    design = np.column_stack([2 * away, np.ones(len(away))])
    sphere = np.linalg.lstsq(design, (away**2).sum(1), rcond=None)[0][:SPACE]
    normal, extent = np.linalg.svd(away, full_matrices=False)[2][-1], np.sqrt(away.var(0).sum())
    return [middle + sphere, *(middle + share * extent * normal for share in BESIDE)]


def _regressed(
    s: np.ndarray, v: np.ndarray, a: np.ndarray, centre: np.ndarray
) -> tuple[np.ndarray, float]:
    """The law's numbers, by least squares across the string, and what they leave."""
    away = s - centre
    far = np.linalg.norm(away, axis=1)
    out = away / np.maximum(far, np.finfo(float).tiny)[:, None]

    def across(x: np.ndarray) -> np.ndarray:
        return (x - (x * out).sum(1, keepdims=True) * out).ravel()

    field = [across(np.broadcast_to(axis, s.shape)) for axis in np.eye(SPACE)]
    design = np.stack([*field, across(-v)], 1)
    told = np.linalg.lstsq(design, across(a), rcond=None)[0]
    left = float(((design @ told - across(a)) ** 2).sum())
    return np.concatenate([[far.mean()], centre, told]), left


def _told(found: Fit) -> bool:
    """Whether the string's length shows, without which a spring to a place is as good, and the
    sphere on which it keeps the body: an orbit lies in a plane.
    """
    length, error = found.numbers["rest"]
    places = np.concatenate([clip.stretches[0].places for clip in found.clips])
    deep = np.linalg.svd(places - places.mean(0), compute_uv=False)[-1] / np.sqrt(len(places))
    return bool(0 < error < VAGUE * length and deep > DEEP * found.errors.total)
