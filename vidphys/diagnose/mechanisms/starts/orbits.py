"""Bodies that one fixed place pulls or pushes, all by one power of the distance, as a sun does."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

import numpy as np

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.choose import pictured
from vidphys.diagnose.mechanisms.fit import race
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.ranking import ranked
from vidphys.diagnose.mechanisms.sense import makes_sense
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

FEWEST = 2  # bodies
UNLIKE = 1.2  # times the least distance, that the largest is at least: others tell of no power
# cosine between two bodies as seen from a place, up to which they are opposite: what pulls two to
# what lies between them may be each other
OPPOSITE = -0.95
TRIED = 2  # times, from accelerations over the fewest frames that show a place
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
    each = (_begun(clips[0], half) for half in HALVES)
    begun = list(islice((x for x in each if x is not None), TRIED))
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
    if len(each) == FEWEST and _opposite(clip, place):
        return None
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


def _opposite(clip: Frames, place: np.ndarray) -> bool:
    """Whether a place lies between two bodies, usually."""
    (first, second), (mine, others) = clip.seen, clip.stretches
    one = mine.places[np.isin(first, second)] - place
    other = others.places[np.isin(second, first)] - place
    cosine = (one * other).sum(-1) / np.linalg.norm(one, axis=-1) / np.linalg.norm(other, axis=-1)
    return bool(np.median(cosine) < OPPOSITE)
