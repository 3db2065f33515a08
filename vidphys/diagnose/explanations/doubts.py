"""What leaves a law in doubt, whatever its rivals are."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.explanations.law_words import SHORT
from vidphys.diagnose.explanations.verdict import ALL
from vidphys.diagnose.mechanisms.charts import Chart, Line
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.quantities import quantities
from vidphys.diagnose.mechanisms.rods import RodsFit
from vidphys.diagnose.mechanisms.starts.curved import once
from vidphys.diagnose.mechanisms.starts.elastic import stretches
from vidphys.diagnose.recordings.units import GRAVITY

NARROWEST = 0.3  # metres of a scene, that the longer side of a picture shows at least
UNSEEN = 0.02  # half sides of a picture, by which a tracker may bend a way: a hundredth of a side
CERTAIN = 5.0  # standard errors of a term's number, below which it may as well not be there
LITTLE = 0.05  # of its speed, that a friction takes in a recording at least, to be seen there
MOVING = ("acceleration", "rate")  # quantities without which a law does not say what moves a body
ASIDE = 0.14  # of the highest speed along a force, that one goes to its side which goes along it
RESTED = 0.02  # of its usual speed, that what has come to rest has at most
# of its speed over its distance from the place that it goes round, and of the cosine between both,
# that they vary on a circle or a spiral at most
ROUND = 0.03
TOLD = 0.05  # standard error of a power of the distance that a slow turn of an orbit tells
WIDE = 0.375  # of ab/L^2: by it a pendulum's ellipse turns, over its rate (Airy 1851)
LEVEL = 0.2  # tangent of a line's angle to the picture's edge, below which it is level
PASSES = "In doubt: nothing acts on it, as on something that passes by. Look at what is followed."
SLOWS = "In doubt: dry friction would slow it alike. Film it until it rests, or comes back."
OUTWEIGHED = (
    "Not told as sure: one body is at least {ratio:.0f} times as heavy as another, and how much "
    "heavier does not show. Give the masses."
)
UNTURNED = "In doubt: it does not turn round; a lens bends a straight way alike. Film for longer."
SETTLES = "In doubt: it comes to rest without a swing, as a hand does. Look at what is followed."
UNRESTED = "In doubt: it does not rest, and what goes away slows alike. Film for longer."
HANGS = "In doubt: a pendulum that swings as little moves alike. A wider swing would tell."
CIRCLES = (
    "In doubt: on a circle at one speed, or a spiral, whatever pulls to its middle moves it alike, "
    "or a force across its way, as a magnet's. Another start would tell."
)
PRECESSES = (
    "In doubt: the ellipse of a pendulum that swings wide turns alike. Let it go from rest, or "
    "swing less wide."
)
STRUCK = (
    "In doubt: it turned round once, which a body that was not followed may have done as well as a "
    "wall. Look at what it bounces off."
)
ONCE = (
    "In doubt: it passes its curve once. What flies, and is pushed across its way as by its spin, "
    "goes alike. Film it to and fro."
)
STIFF = "In doubt: its spring hardly stretches, as a rod or a string does not."
HIDDEN = (
    "In doubt: a second body that was not followed, tied to this one, moves it alike. Film what is "
    "beside it."
)
MISSED = f"In doubt: less than {100 * ALL:g} % of this body's motion is the law's."
UNTOLD = "In doubt: the recording does not tell how strong the force is. Film for longer."


def doubts(fit: Fit) -> list[str]:
    """Of a law, whatever its rivals are, in sentences."""
    out = []
    if terms := [SHORT[kind] for kind in slight(fit)]:
        out.append(f"In doubt: hardly told from none: {', '.join(terms)}. Film for longer.")
    found = {
        HANGS: may_hang(fit),
        UNTURNED: unturned(fit),
        SETTLES: fit.settles,
        UNRESTED: unrested(fit),
        SLOWS: only_slows(fit),
        PASSES: passes(fit),
        CIRCLES: circles(fit),
        PRECESSES: precesses(fit),
        STIFF: stiff(fit),
        ONCE: once(fit),
        STRUCK: struck_once(fit),
        HIDDEN: fit.kinds & {"forcing", "linear"} == {"forcing"},
        MISSED: missed(fit),
        UNTOLD: untold(fit),
    }
    return [*out, *(said for said, holds in found.items() if holds)]


def seen(fit: Fit) -> bool:
    """Whether a camera saw the motion."""
    return fit.model.law.pictured or isinstance(fit, RodsFit)


def slight(fit: Fit) -> list[str]:
    """Terms beside others that may as well not be there, by their numbers' errors and effect.

    The errors allow for mistakes that last and go with the place, of which the likelihoods that
    chose the terms know less.
    """
    law = fit.model.law
    sizes: dict[str, float] = {}
    for name, (value, error) in fit.numbers.items():
        kind = "uniform" if name in law.forces else name.split()[0]
        if kind == "linear" and abs(value) * _seconds(fit) < LITTLE:
            value = 0.0
        sizes[kind] = max(sizes.get(kind, 0.0), abs(value) / max(error, np.finfo(float).tiny))
    asked = law.frictions + (("uniform",) if law.restoring == "uniform" and law.frictions else ())
    return [kind for kind in asked if seen(fit) and sizes.get(kind, np.inf) < CERTAIN]


def _seconds(fit: Fit) -> float:
    return max(float(clip.times[-1] - clip.times[0]) for clip in fit.clips)


def missed(fit: Fit) -> bool:
    """Whether it has less of its bodies' motion than what is explained, whatever others have."""
    return fit.left**2 > (1 - ALL) * fit.spread**2


def untold(fit: Fit) -> bool:
    """Whether it is not told how much what moves its bodies does so."""
    return any(x.name.split()[0] in MOVING and not x.measured for x in quantities(fit))


def unturned(fit: Fit) -> bool:
    """Whether a spring in a picture is not seen to turn a body round: a lens bends a way alike."""
    law = fit.model.law
    if law.restoring != "trap" or law.coupled or law.walls or not law.pictured:
        return False
    rates = [r[:, 1] for r in fit.model.coordinates(fit.values, fit.clips)]
    return all(bool((v @ v[0] > 0).all()) for v in rates)


def unrested(fit: Fit) -> bool:
    """Whether dry friction alone slows what a camera sees, and never stops it."""
    if fit.kinds != {"dry"} or not fit.model.law.pictured:
        return False
    rates = (r[:, 1] for r in fit.model.coordinates(fit.values, fit.clips))
    speeds = [np.linalg.norm(v, axis=-1) for v in rates]
    return all(bool(v[-1] > RESTED * v.mean()) for v in speeds)


def passes(fit: Fit) -> bool:
    """Whether nothing acts on what a camera sees, so that it may be something that passes by."""
    return fit.model.law.pictured and not fit.kinds


def circles(fit: Fit) -> bool:
    """Whether a body goes round a place so evenly that the law of the pull does not show.

    On a circle at one speed, or on a spiral on which its speed and its distance shrink alike.
    """
    law, charts = fit.model.law, fit.model.charts
    alone = len(charts) == 1 and charts[0].name in ("plane", "turned")  # several circles tell
    if alone and law.turning and law.restoring == "none":
        return len(fit.clips) == 1 and _flat(_rolled(fit)[0][:, 0])
    if not alone or law.restoring not in ("trap", "centre") or law.walls or law.turning:
        return False
    if law.restoring == "centre" and fit.numbers["steeper"][1] < TOLD:
        return False
    return all(_evenly(_from_the_middle(fit, r[:, 0]), r[:, 1]) for r in _rolled(fit))


def _flat(places: np.ndarray) -> bool:
    """Whether a way ``(t, d)`` lies in a plane."""
    sizes = np.linalg.svd(places - places.mean(0), compute_uv=False)
    return len(sizes) < 3 or bool(sizes[2] < ROUND * sizes[1])


def _rolled(fit: Fit) -> list[np.ndarray]:
    return fit.model.coordinates(fit.values, fit.clips)


def _from_the_middle(fit: Fit, places: np.ndarray) -> np.ndarray:
    """Of what pulls a body, to its places ``(t, d)``."""
    law, numbers = fit.model.law, fit.numbers
    if law.restoring in ("centre", "elastic"):
        return places - law.centre(numbers)
    stiffness = [value for name, (value, _) in numbers.items() if name.startswith("stiffness")]
    return places - np.array([numbers[x][0] for x in law.forces]) / np.array(stiffness)


def _evenly(away: np.ndarray, v: np.ndarray) -> bool:
    """Whether a body's speed keeps its share of the distance, and its angle to the way there."""
    far, speed = np.linalg.norm(away, axis=-1), np.linalg.norm(v, axis=-1)
    if not (far.all() and speed.all()):
        return False  # it rests, or goes through the middle
    share, cosine = speed / far, (away * v).sum(-1) / (far * speed)
    round_it = abs(cosine.mean()) < 1 - ROUND
    return bool(round_it and share.std() < ROUND * share.mean() and cosine.std() < ROUND)


def struck_once(fit: Fit) -> bool:
    """Whether a camera sees what nothing pulls turn round once: so do two bodies that collide."""
    law = fit.model.law
    if "collision" in fit.kinds or not (law.walls and law.pictured and law.restoring == "none"):
        return False
    return sum(len(clip.impacts) for clip in fit.clips) == 1


def stiff(fit: Fit) -> bool:
    """Whether a spring from a fixed place keeps its length as well as a rod."""
    return fit.model.law.restoring == "elastic" and not stretches(fit)


def precesses(fit: Fit) -> bool:
    """Whether a pendulum's ellipse turns as much that is as wide as it is long at most."""
    law = fit.model.law
    if not law.turning or law.restoring != "trap":
        return False
    rate = np.sqrt(fit.numbers["stiffness"][0])
    turned = 0.5 * np.linalg.norm([fit.numbers[name][0] for name in law.turns])
    first = np.linspace(0.0, 2 * np.pi / rate, 100)  # seconds of the first swing
    far = [
        np.linalg.norm(_from_the_middle(fit, fit.path(first, i)[:, 0]), axis=-1)
        for i in range(len(fit.clips))
    ]
    return bool(turned < WIDE * rate * max(x.min() / x.max() for x in far))


def only_slows(fit: Fit) -> bool:
    """Whether a constant force only slows what a camera sees go straight, as dry friction does."""
    law = fit.model.law
    if law.restoring != "uniform" or law.frictions or law.walls or not law.pictured:
        return False
    if fit.kinds & {"collision", "curve"}:  # such bodies do not go straight
        return False
    rates = np.concatenate([r[:, 1] for r in fit.model.coordinates(fit.values, fit.clips)])
    force = np.array([fit.numbers[name][0] for name in law.forces])
    way = force / np.linalg.norm(force)
    along = rates @ way
    aside = np.linalg.norm(rates - along[:, None] * way, axis=-1)
    return bool((along < 0).all() and (aside < ASIDE * np.abs(along).max()).all())


def may_hang(fit: Fit) -> bool:
    """Whether what swings on level lines in a picture may be pendulums that swing little.

    One of its period would rise by less than a tracker may be off, in a picture of as small a
    scene as people film.
    """
    law = fit.model.law
    springs = law.restoring == "trap" and not law.walls and law.pictured
    if not (springs and all(map(_level, fit.model.charts))):
        return False
    coordinates = fit.model.coordinates(fit.values, fit.clips)
    swings = 0.5 * np.max([np.ptp(r[:, 0], 0) for r in coordinates], axis=0)
    stiffness = [x for name, (x, _) in fit.numbers.items() if name.startswith("stiffness")]
    lengths = 2 / NARROWEST * GRAVITY / np.array(stiffness)
    hung = np.delete(swings, law.loose)
    return bool((hung**2 / (2 * lengths) < UNSEEN).all())


def _level(chart: Chart) -> bool:
    if not isinstance(chart, Line):
        return False
    x, y = chart.along
    return abs(y) < LEVEL * abs(x)
