"""Bodies that meet: one law of all, begun at the meetings that were seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.charts import Chart, Line, Plane
from vidphys.diagnose.mechanisms.fit import fit, race
from vidphys.diagnose.mechanisms.fitted import Fit, Model, residuals_of
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.impacts.alone import walled_apart
from vidphys.diagnose.mechanisms.impacts.colliding import Colliding, Contact
from vidphys.diagnose.mechanisms.impacts.kinks import find_impacts
from vidphys.diagnose.mechanisms.impacts.meetings import Meeting, meetings_of
from vidphys.diagnose.mechanisms.impacts.pushes import collisions_of, lasts, weighed, weighed_slopes
from vidphys.diagnose.mechanisms.measurement import Stretch
from vidphys.diagnose.mechanisms.ranking import LIKELIER
from vidphys.diagnose.mechanisms.starts.guesses import THIN

CURVED = 8  # frames before a meeting, from which a path's bend is read too
REACHES = (1.0, 0.9, 0.8, 1.1, 1.2)  # of the distance at the kink, at which bodies may meet
VAGUE = 0.3  # of a mass ratio: a standard error from which collisions tell nothing of it
CLEARLY = 10.0  # of log likelihood after its price, for a term that a camera's errors may feign
ROUNDS = 3  # terms that are added at most
ADDED = (  # what a law is tried with beside collisions
    {"friction": "linear"},
    {"friction": "dry"},
    {"friction": "square"},
    {"restoring": "uniform"},
    {"rubs": True},
)


def parties(clips: Sequence[Frames]) -> list[tuple[int, ...]]:
    """Bodies that meet each other, or one another's partners, by their numbers."""
    met: list[set[int]] = []
    for meeting in (x for clip in clips for x in meetings_of(clip)):
        pair = {meeting.one, meeting.two}
        apart = [party for party in met if not party & pair]
        met = [*apart, pair.union(*(party for party in met if party & pair))]
    return [tuple(sorted(party)) for party in met]


def colliding(clips: Sequence[Frames], camera: bool = False) -> list[Fit]:
    """Laws of bodies that meet each other, or one another's partners; best first.

    Args:
        clips: of all those bodies and no other.
        camera: whether places are in a picture, counted from its middle.

    Returns:
        None where what pushes the bodies lasts, or where no such law holds.
    """
    found = [meetings_of(clip) for clip in clips]
    joined = [meeting for each in found for meeting in each]
    if not joined:
        return []
    runners = []
    for free, along in _models(clips, joined, camera):
        model, known = walled_apart(clips, found, free, along)
        runners.append((model, [_guess(clips, found, model, along, known)]))
        if model.law.walls:  # of which a shaken camera may feign one
            runners.append((free, [_guess(clips, found, free, along, {})]))
    walls = any(model.law.walls for model, _ in runners)
    fits = race(clips, runners, _lengths(clips, found, walls))
    fits = sorted(fits, key=lambda x: (not _makes_sense(x), -x.score))
    if not fits:
        return []
    best, others = _with_terms(clips, fits[0], camera)
    if not _makes_sense(best) or lasts(best):
        return []
    return [best, *sorted((x for x in others if _makes_sense(x)), key=lambda x: -x.score)]


# where fits begin


def _models(
    clips: Sequence[Frames], meetings: Sequence[Meeting], camera: bool
) -> list[tuple[Model, np.ndarray | None]]:
    """In the plane, and on a line where all bodies keep to parallel ones, with its direction."""
    bodies, space = len(clips[0].stretches), meetings[0].places.shape[1]
    pairs = sorted({(x.one, x.two) for x in meetings})
    out: list[tuple[Model, np.ndarray | None]] = []
    contacts = _contacts(pairs, meetings, np.eye(space)[0])
    plane = Colliding(bodies * space, contacts=contacts, pictured=camera and space == view.FLAT)
    out.append((Model(plane, (Plane(space),) * bodies), None))
    if space > 1:
        along = _line(clips)
        if along is not None:
            law = Colliding(bodies, contacts=_contacts(pairs, meetings, along))
            charts: tuple[Chart, ...] = (Line(tuple(along.tolist())),) * bodies
            out.append((Model(law, charts), along))
    return out


def _contacts(
    pairs: Sequence[tuple[int, int]], meetings: Sequence[Meeting], along: np.ndarray
) -> tuple[Contact, ...]:
    """Of the pairs that meet; the second lies where it is pushed."""
    out = []
    for pair in pairs:
        first = next(x for x in meetings if (x.one, x.two) == pair)
        out.append(Contact(*pair, float(np.sign(first.normal @ along)) or 1.0))
    return tuple(out)


def _line(clips: Sequence[Frames]) -> np.ndarray | None:
    """The direction that all bodies keep to, if they do."""
    away = [s.places - s.places.mean(0) for clip in clips for s in clip.stretches]
    _, sizes, axes = np.linalg.svd(np.concatenate(away), full_matrices=False)
    if sizes[1] > THIN * sizes[0]:
        return None
    return axes[0] * np.sign(axes[0][np.abs(axes[0]).argmax()])


def _guess(
    clips: Sequence[Frames],
    found: Sequence[Sequence[Meeting]],
    model: Model,
    along: np.ndarray | None,
    walls: Mapping[str, float],
) -> np.ndarray:
    """Numbers of a law without friction, and starts, from the meetings and those of walls."""
    law = model.law
    assert isinstance(law, Colliding)
    meetings = [x for each in found for x in each]
    known = {**walls, **dict.fromkeys(view.NAMES, 0.0)}
    known["restitution"] = float(np.median([x.restitution for x in meetings]))
    for number, contact in enumerate(law.contacts, 1):
        same = [x for x in meetings if (x.one, x.two) == (contact.one, contact.two)]
        if law.space == 1:
            axis = np.ones(1) if along is None else along
            apart = [contact.side * (x.places[1] - x.places[0]) @ axis for x in same]
        else:
            apart = [x.distance for x in same]
        known[f"reach {number}"] = float(np.median(apart))
    for body, mass in enumerate(_masses(meetings, law.bodies)[1:], 2):
        known[f"mass {body}"] = mass
    starts = [_start(clip, each, law, along) for clip, each in zip(clips, found, strict=True)]
    values = np.concatenate([[known[name] for name in law.names], *starts])
    reaches = np.array([name.startswith("reach") for name in law.names] + [False] * len(starts[0]))
    reaches = np.pad(reaches, (0, len(values) - len(reaches)))
    tried = [np.where(reaches, share * values, values) for share in REACHES]
    return min(tried, key=lambda x: _off(clips, model, x))


def _off(clips: Sequence[Frames], model: Model, values: np.ndarray) -> float:
    """Mean distance of a law's paths from what was seen."""
    left = residuals_of(clips, model, values)[0]
    return float(np.mean([np.linalg.norm(x, axis=-1).mean() for x in left]))


def _masses(meetings: Sequence[Meeting], bodies: int) -> np.ndarray:
    """Of all bodies over the first one's, from how much each speed changes."""
    masses = {0: 1.0}
    for _ in range(bodies):
        for x in meetings:
            same = [y.change for y in meetings if (y.one, y.two) == (x.one, x.two)]
            one, two = (np.sqrt(sum((c[k] ** 2).sum() for c in same)) for k in (0, 1))
            if x.one in masses and x.two not in masses:
                masses[x.two] = float(masses[x.one] * one / two)
            elif x.two in masses and x.one not in masses:
                masses[x.one] = float(masses[x.two] * two / one)
    return np.array([masses[b] for b in range(bodies)])


def _start(
    clip: Frames, meetings: Sequence[Meeting], law: Colliding, along: np.ndarray | None
) -> np.ndarray:
    """Places and rates of all bodies at the clip's begin, by a parabola up to what changes them."""
    places, rates = [], []
    for body, stretch in enumerate(clip.stretches):
        own = [x.time for x in meetings if body in (x.one, x.two)]
        if law.walls:
            own += _struck(stretch)
        before = int(np.searchsorted(stretch.times, min(own, default=np.inf)))
        few = max(before, 3)
        t, x = stretch.times[:few], stretch.places[:few]
        x = x if along is None else x @ along[:, None]
        numbers = np.polyfit(t, x, 2 if few > CURVED else 1)
        places.append(numbers[-1])
        rates.append(numbers[-2])
    return np.concatenate([*places, *rates])


def _struck(stretch: Stretch) -> list[float]:
    """Seconds at which a body's speed changes at once."""
    return [float(stretch.times[x.frame]) for x in find_impacts(stretch.times, stretch.places)]


def _lengths(clips: Sequence[Frames], found: Sequence[Sequence[Meeting]], walls: bool) -> list[int]:
    """Frames that are fitted one after the other, each time with one meeting or bounce more."""
    longest = max(len(c.times) for c in clips)
    if len(clips) > 1:
        return [longest]
    times = [x.time for x in found[0]]
    if walls:
        times = sorted(times + [t for s in clips[0].stretches for t in _struck(s)])
    ends = [0.5 * (a + b) for a, b in zip(times[:-1], times[1:], strict=True)]
    return [*np.searchsorted(clips[0].times, ends).tolist(), longest]


# terms beside collisions


def _with_terms(clips: Sequence[Frames], base: Fit, camera: bool) -> tuple[Fit, list[Fit]]:
    """The base with those terms that its residuals ask for, and what else was tried."""
    best, others = base, []
    for _ in range(ROUNDS):
        models = _more(best)
        tried = sorted(((_gain(best, other), k) for k, other in enumerate(models)), reverse=True)
        likely = [models[k] for gain, k in tried[:2] if gain > 0]
        better = [x for model in likely if (x := _fitted(clips, best, model)) is not None]
        better = sorted((x for x in better if _makes_sense(x)), key=lambda x: -x.score)
        asked = CLEARLY if camera and better and better[0].kinds != best.kinds else LIKELIER
        if not better or better[0].score < best.score + asked:
            others += better
            break
        others += [best, *better[1:]]
        best = better[0]
    return best, others


def _more(base: Fit) -> list[Model]:
    """Models with one term more."""
    law = base.model.law
    plain = Colliding(law.coordinates)
    out = []
    for change in ADDED:
        ((name, value),) = change.items()
        plane = base.model.charts[0].name == "plane" and base.model.charts[0].size == 2
        if getattr(law, name) == getattr(plain, name) and (plane or name != "rubs"):
            out.append(Model(replace(law, **change), base.model.charts))
    return out


def _widened(base: Fit, model: Model) -> tuple[np.ndarray, list[int]]:
    """The base's values with zeros for new numbers, and where those are."""
    known = dict(zip(base.model.law.names, base.values.tolist(), strict=False))
    numbers = [known.get(name, 0.0) for name in model.law.names]
    new = [i for i, name in enumerate(model.law.names) if name not in known]
    return np.concatenate([numbers, base.values[len(base.model.law.names) :]]), new


def _gain(base: Fit, model: Model) -> float:
    """Log likelihood that new numbers bring, about, by the base's slopes, less their price."""
    values, new = _widened(base, model)
    joint = np.concatenate([values, *base.geometry])
    slope, left = weighed_slopes(base, model, joint), weighed(base)
    if not np.isfinite(slope).all():
        return -np.inf
    old = np.delete(slope, new, axis=1)
    both = np.column_stack([slope[:, new], left])
    both = both - old @ np.linalg.lstsq(old, both, rcond=None)[0]
    told, rest = both[:, :-1], both[:, -1]
    kept = rest - told @ np.linalg.lstsq(told, rest, rcond=None)[0]
    ratio = (rest @ rest) / max(kept @ kept, np.finfo(float).tiny)
    return float(0.5 * len(left) * np.log(ratio) - 0.5 * np.log(len(left)) * len(new))


def _fitted(clips: Sequence[Frames], base: Fit, model: Model) -> Fit | None:
    return fit(clips, model, _widened(base, model)[0])


def _makes_sense(found: Fit) -> bool:
    """Whether bodies collide in it, and its numbers mean what their names say."""
    for name, (value, error) in found.numbers.items():
        root = name.partition(" ")[0]
        if root == "mass" and not (value > 0 and error < VAGUE * value):
            return False
        if root in ("linear", "square", "dry") and value < -2 * error:
            return False  # a drive, which the menu tells of
        if root == "restitution" and not (-2 * error <= value < 1 + 2 * error and error < VAGUE):
            return False
    return bool(collisions_of(found))
