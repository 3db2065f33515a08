"""A body that a fixed place pushes or pulls, by a power of the distance: where fits begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.fit import fit, race
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames, thinned_to
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import HALVES, Local, local
from vidphys.diagnose.mechanisms.terms import COULOMB

# than Coulomb's law, that fits begin with; the second is of two dipoles, the third grows as a cube
STEEPER = (0.0, 2.0, -5.0)
ASIDE = (0.1, 0.2, 0.4, 0.8)  # of the path's extent, that a place may lie off where a body turns
FLAT = 2  # dimensions of the plane
VAGUE = 0.3  # of the nearest distance, or of the strength: a standard error from which none is seen
LEAST, MOST = 0.25, 12.0  # powers of the distance; beyond, what pushes is as good as a wall
GROWS, GROWS_MOST = -1.3, -8.0  # powers of what grows; between these and those it is a spring's
NEAREST = 0.02  # of the extent, that a body comes to the place at most
ENOUGH = 200  # frames, of which it is told which of the guesses is right
EARLY = 4  # one of so many parts of the frames, in which an orbit hardly shrinks
BENT = 0.3  # radians, by which a place must turn a body round it


def centred(clips: Sequence[Frames]) -> list[Fit]:
    """Laws of a body that a fixed place pushes or pulls, best first.

    Args:
        clips: of the body.
    """
    stretch = clips[0].stretches[0]
    if len(clips) > 1 or stretch.places.shape[1] != FLAT or clips[0].inputs is not None:
        return []
    runners = _begun(stretch.times, stretch.places)
    few = thinned_to(clips, ENOUGH)
    best = _best(few, runners)
    if best is None or not best.holds:
        best = _slowing(few, runners) or best
    if best is not None and len(few[0].times) < len(clips[0].times):
        best = fit(clips, best.model, best.values)
    if best is None or not told(best):
        return []
    rubbed = lossy(clips, best) if best.model.law.friction == "none" else None
    return [best, *([rubbed] if rubbed is not None and told(rubbed) else [])]


def _best(clips: Sequence[Frames], runners: Sequence[tuple[Model, list[np.ndarray]]]) -> Fit | None:
    """The likeliest law that is told, where the frames are fitted all at once."""
    found = race(clips, runners, [len(clips[0].times)]) if runners else []
    return max(filter(told, found), key=lambda x: x.score, default=None)


def _slowing(
    clips: Sequence[Frames], runners: Sequence[tuple[Model, list[np.ndarray]]]
) -> Fit | None:
    """A law with friction, over ever more frames: an orbit that shrinks is no other's for long."""
    first = _best([clip.upto(len(clip.times) // EARLY) for clip in clips], runners)
    if first is None or not first.holds:
        return None
    found = race(clips, [_with_friction(first)])
    return found[0] if found and told(found[0]) else None


def lossy(clips: Sequence[Frames], found: Fit) -> Fit | None:
    """The same law with a friction that goes with the speed."""
    model, (values,) = _with_friction(found)
    return fit(clips, model, values)


def _with_friction(found: Fit) -> tuple[Model, list[np.ndarray]]:
    """The same law with a friction, and its numbers at first."""
    law = replace(found.model.law, friction="linear")
    values = np.insert(found.values, law.names.index("linear"), 0.0)
    return Model(law, found.model.charts), [values]


def told(found: Fit) -> bool:
    """Whether what was seen tells of a fixed place: where it is, and how strong."""
    law = found.model.law
    if law.restoring != "centre":
        return True
    numbers, near = found.numbers, nearest(found)
    strength, error = numbers["strength"]
    vague = max(error for name, (_, error) in numbers.items() if name.startswith("centre"))
    power = law.power({name: value for name, (value, _) in numbers.items()})
    return bool(
        error < VAGUE * abs(strength)
        and vague < VAGUE * near
        and (GROWS_MOST < power < GROWS or LEAST < power < MOST)
        and (power < GROWS or near > NEAREST * found.spread)
        and _round(found) > BENT
    )


def nearest(found: Fit) -> float:
    """Distance at which a body passes the fixed place."""
    return float(np.linalg.norm(_away(found), axis=-1).min())


def _away(found: Fit) -> np.ndarray:
    """From the fixed place to each body ``(t, n, d)``."""
    place = found.model.law.centre(found.numbers)
    s = found.model.coordinates(found.values, found.clips)[0][:, 0]
    return s.reshape(len(s), -1, len(place)) - place


def _round(found: Fit) -> float:
    """Radians through which a body is seen from the fixed place, the most."""
    away = _away(found)
    return float(np.ptp(np.unwrap(np.arctan2(away[..., 1], away[..., 0]), axis=0), axis=0).max())


def _begun(times: np.ndarray, places: np.ndarray) -> list[tuple[Model, list[np.ndarray]]]:
    """Laws with numbers and starts, by speeds and accelerations over more and more frames."""
    extent, out = float(np.sqrt(places.var(0).sum())), []
    for half in HALVES[1:]:
        if 2 * half + 1 > max(len(times) // 2, 5):
            break
        seen = local(times, places, half)
        turned_at = seen.s[int(np.linalg.norm(seen.a, axis=1).argmax())]
        start = start_of(seen).ravel()
        guesses = []
        for place in _places(seen, turned_at, extent):
            away = seen.s - place
            r, near = np.linalg.norm(away, axis=1), float(np.linalg.norm(turned_at - place))
            if r.min() < NEAREST * extent:
                continue
            for steeper in STEEPER:
                along = (seen.a * away).sum(1) / r
                strength = strength_of(along, (near / r) ** (COULOMB + steeper))
                guesses.append(np.array([strength, steeper, *place, *start]))
        law = Law(FLAT, "centre", turned_at=tuple(turned_at.tolist()))
        out += [(Model(law, (Plane(FLAT),)), guesses)] if guesses else []
    return out


def _places(seen: Local, turned_at: np.ndarray, extent: float) -> list[np.ndarray]:
    """Where accelerations point to or from, and off the place where the body turns most."""
    found = [aimed_at(seen.s, seen.a)]
    way = seen.a[int(np.linalg.norm(seen.a, axis=1).argmax())]
    way = way / max(float(np.linalg.norm(way)), np.finfo(float).tiny)
    return found + [turned_at - sign * x * extent * way for x in ASIDE for sign in (1.0, -1.0)]


def aimed_at(s: np.ndarray, a: np.ndarray) -> np.ndarray:
    """The place ``(2,)`` to or from which accelerations ``(t, 2)`` at some places point."""
    normal = np.column_stack([a[:, 1], -a[:, 0]])
    return np.linalg.lstsq(normal, (normal * s).sum(1), rcond=None)[0]


def strength_of(along: np.ndarray, push: np.ndarray) -> float:
    """What a push ``(t,)`` of strength one must be multiplied by, by accelerations along it."""
    return float((push @ along) / (push @ push))


def start_of(seen: Local) -> np.ndarray:
    """Place and speed ``(2, d)`` at the clip's first frame."""
    return np.stack([seen.s[0] - seen.v[0] * seen.times[0], seen.v[0]])
