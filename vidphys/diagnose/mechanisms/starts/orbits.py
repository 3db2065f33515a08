"""Bodies that one fixed place pulls or pushes, all by one power of the distance, as a sun does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.choose import makes_sense, pictured, ranked
from vidphys.diagnose.mechanisms.fit import race
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.centre import (
    FLAT,
    aimed_at,
    lossy,
    start_of,
    strength_of,
    told,
)
from vidphys.diagnose.mechanisms.starts.guesses import HALVES, joined, local
from vidphys.diagnose.mechanisms.terms import COULOMB
from vidphys.diagnose.recordings.motion import LEAST_FRAMES

FEWEST = 3  # bodies: what pulls two of them to one place may be each other
UNLIKE = 1.2  # times the least distance, that the largest is at least: others tell of no power
AIMED = 0.9  # of the bodies' squared accelerations, that lies along the way to one place at least


def orbiting(clips: Sequence[Frames], camera: bool) -> list[Fit]:
    """Laws of bodies about one fixed place, best first; none where nothing speaks for one.

    Where orbits are round one alone does not tell the power of the distance; several do, as they
    are of different sizes (Kepler's third law).

    Args:
        clips: of all bodies.
        camera: whether the places are in a picture.
    """
    stretches = clips[0].stretches
    short = min(len(s.times) for s in stretches) < LEAST_FRAMES
    flat = stretches[0].places.shape[1] == FLAT and clips[0].inputs is None
    if len(clips) > 1 or len(stretches) < FEWEST or short or not flat:
        return []
    begun = [x for x in (_begun(clips[0], half) for half in HALVES[:2]) if x is not None]
    best = max(race(clips, begun), key=lambda x: x.score, default=None) if begun else None
    if best is None:
        return []
    best = pictured(clips, best) if camera else best
    both = best, lossy(clips, best)
    return ranked([x for x in both if x is not None and told(x) and makes_sense(x)])


def _begun(clip: Frames, half: int) -> tuple[Model, list[np.ndarray]] | None:
    """A law and where its fits begin, by accelerations over so many frames on each side."""
    each = [local(s.times, s.places, half) for s in clip.stretches]
    s, a = joined(each, "sa")
    place = aimed_at(s, a)
    r = np.linalg.norm(s - place, axis=1)
    along = (a * (s - place)).sum(1) / np.maximum(r, np.finfo(float).tiny)
    one_way = bool((along < 0).all() or (along > 0).all())  # so nothing is at the place itself
    if not one_way or (along**2).sum() < AIMED * (a**2).sum() or r.max() < UNLIKE * r.min():
        return None
    turned_at = s[int(np.abs(along).argmax())]
    near = float(np.linalg.norm(turned_at - place))
    power = -float(np.polyfit(np.log(r), np.log(np.abs(along)), 1)[0])
    starts = np.stack([start_of(x) for x in each], 1).reshape(2, -1)
    guesses = []
    for p in (power, COULOMB):
        strength = strength_of(along, (near / r) ** p)
        guesses.append(np.array([strength, p - COULOMB, *place, *starts.ravel()]))
    law = Law(FLAT * len(each), "centre", turned_at=tuple(turned_at.tolist()))
    return Model(law, (Plane(FLAT),) * len(each)), guesses
