"""A weight on a spring from a fixed place, that swings and stretches: where fits begin."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.optimize import minimize

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.fit import with_friction_or_none
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import Local, halves, local, start_of

SPACES = (2, 3)  # dimensions in which it swings and stretches
AROUND = np.linspace(-3.0, 3.0, 7)  # extents of the path, in which the fixed place is sought
BEST = 2  # places with which fits begin
STIFF = 0.03  # of its length, by which what keeps it seems to vary at most
VAGUE = 0.1  # of the rest length: its standard error, and the place's, from which they do not show


def elastic(clips: Sequence[Frames]) -> list[Fit]:
    """Laws of a body that a spring of a rest length ties to a fixed place, in a steady field.

    Args:
        clips: of the body.
    """
    stretch = clips[0].stretches[0]
    size = stretch.places.shape[1]
    if len(clips) > 1 or size not in SPACES or clips[0].inputs is not None:
        return []
    model = Model(Law(size, "elastic", "linear"), (Plane(size),))
    begun = [
        guess
        for half in halves(clips)
        for guess in _begun(local(stretch.times, stretch.places, half))
    ]
    return [x for x in with_friction_or_none(clips, [(model, begun)]) if _told(x)]


def stretches(found: Fit) -> bool:
    """Whether a spring changes its length by more than a rod or a string seems to."""
    centre = found.model.law.centre(found.numbers)
    rolled = found.model.coordinates(found.values, found.clips)
    far = [np.linalg.norm(r[:, 0] - centre, axis=-1) for r in rolled]
    return any(bool(x.std() > STIFF * x.mean()) for x in far)


def _begun(seen: Local) -> list[np.ndarray]:
    """The law's numbers and the start, for the places from which a spring leaves least."""
    middle, extent = seen.s.mean(0), np.sqrt(seen.s.var(0).sum())
    places = [middle + extent * np.array(x) for x in product(AROUND, repeat=len(middle))]
    out = []
    for place in sorted(places, key=lambda x: _regressed(seen, x)[1])[:BEST]:
        nearer = minimize(lambda x: _regressed(seen, x)[1], place, method="Nelder-Mead").x
        stiffness, push, *rest = _regressed(seen, nearer)[0]
        numbers = [stiffness, push / stiffness, *nearer, *rest]
        out.append(np.concatenate([numbers, start_of(seen)]))
    return out


def _regressed(seen: Local, place: np.ndarray) -> tuple[np.ndarray, float]:
    """Stiffness, the rest length's push, field and friction of a spring from a place by least
    squares, and what they leave.
    """
    away = seen.s - place
    along = away / np.maximum(np.linalg.norm(away, axis=1), np.finfo(float).tiny)[:, None]
    field = [np.broadcast_to(axis, away.shape) for axis in np.eye(away.shape[1])]
    design = np.stack([x.ravel() for x in (-away, along, *field, -seen.v)], 1)
    found = np.linalg.lstsq(design, seen.a.ravel(), rcond=None)[0]
    return found, float(((design @ found - seen.a.ravel()) ** 2).sum())


def _told(found: Fit) -> bool:
    """Whether the rest length shows, without which it is a trap, and the place."""
    rest, error = found.numbers["rest"]
    vague = max(e for name, (_, e) in found.numbers.items() if name.startswith("centre"))
    return rest > 0 and max(error, vague) < VAGUE * rest
