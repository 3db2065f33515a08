"""A weight on a string that goes slack, as where it is swung too slowly to go over the top."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.fit import with_friction_or_none
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import (
    circle_through,
    halves,
    joined,
    seen_in,
    start_of,
)

FLAT = 2  # dimensions of the plane
TRIED = 600  # circles through three places
CELL = 0.04  # of half the path's extent: of places that lie so near each other one is looked at
SLIM = 0.05  # twice a triangle's surface over the square of a side, that tells a circle
NEAR, BEYOND = 0.02, 0.06  # of half the extent: what lies on a circle, and outside of it at most
LEAST = 0.97  # of its length, to which a slack string is seen to let a weight come
VAGUE = 0.1  # of its length: a standard error from which it is not told


def slack(clips: Sequence[Frames]) -> list[Fit]:
    """Laws of a body on a string that goes slack, in a steady field.

    Args:
        clips: of the body.
    """
    places = [clip.stretches[0].places for clip in clips]
    if places[0].shape[1] != FLAT or clips[0].inputs is not None:
        return []
    found = _string(np.concatenate(places))
    if found is None:
        return []
    centre, length = found
    model = Model(Law(FLAT, "string", "linear"), (Plane(FLAT),))
    begun = []
    for half in halves(clips):
        seen = seen_in(clips, places, half)
        s, v, a = joined(seen, "sva")
        across = (s - centre) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        far = np.linalg.norm(across, axis=1, keepdims=True)
        across /= np.maximum(far, np.finfo(float).tiny)  # where no string pulls
        design = np.column_stack([across, -(v * across).sum(1)])
        told = np.linalg.lstsq(design, (a * across).sum(1), rcond=None)[0]
        begun.append(np.concatenate([[length], centre, told, *map(start_of, seen)]))
    return [x for x in with_friction_or_none(clips, [(model, begun)]) if _told(x)]


def _string(places: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Where a string hangs, and its length: the circle on which most places lie and outside of
    which none does, if some lie within.
    """
    half = 0.5 * float(np.ptp(places, axis=0).max())
    cells = np.floor(places / (CELL * half)) if half else places
    places = places[np.unique(cells, axis=0, return_index=True)[1]]  # it hangs still for long
    centres, radii = _circles(places)
    out = np.linalg.norm(places - centres[:, None], axis=2) - radii[:, None]
    on = (np.abs(out) < NEAR * half) & (out < BEYOND * half).all(1)[:, None]
    if not on.any():
        return None
    rim = places[on[on.sum(1).argmax()]]
    centre = circle_through(rim)
    if centre is None:
        return None
    length = float(np.linalg.norm(rim - centre, axis=1).mean())
    within = np.linalg.norm(places - centre, axis=1).min() < LEAST * length
    return (centre, length) if within else None


def _circles(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres ``(c, 2)`` and radii ``(c,)`` of circles through three places drawn by chance.

    So a circle is found on which many lie, but not all (Fischler and Bolles 1981, Commun. ACM 24).
    """
    draws = np.random.default_rng(0).integers(len(places), size=(3, TRIED))
    one, two, three = places[draws]
    b, c = two - one, three - one
    twice = 2 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    bent = np.abs(twice) > SLIM * (b**2).sum(1)
    one, b, c, twice = one[bent], b[bent], c[bent], twice[bent]
    bb, cc = (b**2).sum(1), (c**2).sum(1)
    turned = np.stack([c[:, 1] * bb - b[:, 1] * cc, b[:, 0] * cc - c[:, 0] * bb], 1)
    away = turned / twice[:, None]
    return one + away, np.linalg.norm(away, axis=1)


def _told(found: Fit) -> bool:
    """Whether the string's length shows, and that it goes slack."""
    length, error = found.numbers["rest"]
    centre = found.model.law.centre(found.numbers)
    rolled = found.model.coordinates(found.values, found.clips)
    near = min(float(np.linalg.norm(r[:, 0] - centre, axis=-1).min()) for r in rolled)
    return length > 0 and error < VAGUE * length and near < LEAST * length
