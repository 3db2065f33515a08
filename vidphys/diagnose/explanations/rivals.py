"""Laws that are nearly as likely as the one that is told, and what would tell them apart."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from vidphys.diagnose.mechanisms.charts import Chart, Line
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.mechanism import Group, Mechanism
from vidphys.diagnose.mechanisms.rods import RodsFit
from vidphys.diagnose.recordings.units import GRAVITY

CLEAR = 4.0  # of log likelihood after its price, within which another law may be the true one
LASTING = 2.0  # times that, where errors last: what they are like is known less well
# The same where a camera saw it: in clips filmed for development wrong forms of friction led by up
# to 20, and of the right ones that were explained 3 of 43 led by less.
SEEN = 20.0
NARROWEST = 0.3  # metres of a scene, that the longer side of a picture shows at least
UNSEEN = 0.02  # half sides of a picture, by which a tracker may bend a way: a hundredth of a side
CERTAIN = 5.0  # standard errors of a term's number, below which it may as well not be there
STRAIGHT = 0.99  # cosine of the angle between a way and a force, from which it goes along it
RESTED = 0.02  # of its usual speed, that what has come to rest has at most
LEVEL = 0.2  # tangent of a line's angle to the picture's edge, below which it is level
PASSES = "Nothing acts on it, as on something that passes by: look at what is followed."
SLOWS = "Dry friction would slow it alike. Film it until it rests, or comes back."
UNTURNED = "It is not seen to turn round: a lens bends a straight way alike. Film it for longer."
UNRESTED = "It is not seen to rest: what goes away from the camera slows alike. Film it for longer."
SHORT = {
    "linear": "friction ~ v",
    "square": "friction ~ v²",
    "dry": "dry friction",
    "uniform": "constant acceleration",
    "trap": "spring to a place",
    "pendulum": "pendulum on an arc",
    "centre": "a fixed place that pushes or pulls",
    "lift": "lift by its spin",
}


def near(group: Group) -> list[Fit]:
    """Laws of other terms that may be the true one."""
    lasts = group.fit.errors.smooth > group.fit.errors.white
    clear = CLEAR * (LASTING if lasts else 1.0)
    least = group.fit.score - (SEEN if _seen(group.fit) else clear)
    return [x for x in group.others if x.score > least and x.kinds != group.fit.kinds]


def _seen(fit: Fit) -> bool:
    """Whether a camera saw the motion."""
    return fit.model.law.pictured or isinstance(fit, RodsFit)


def undecided(mechanism: Mechanism) -> bool:
    """Whether another law does as well: one without a term that is told, or one that is known by
    its kind.

    One that has another term beside those that are told is no doubt of them, but for a friction of
    what swings: nothing swings for ever.
    """
    for group in mechanism.groups:
        if any(swings_on(group.fit) or not x.kinds > group.fit.kinds for x in near(group)):
            return True
    return any(
        may_hang(g.fit)
        or unturned(g.fit)
        or unrested(g.fit)
        or passes(g.fit)
        or only_slows(g.fit)
        or slight(g.fit)
        for g in mechanism.groups
    )


def swings_on(fit: Fit) -> bool:
    """Whether it swings, and no friction is told."""
    law = fit.model.law
    return law.restoring in ("trap", "pendulum") and not law.frictions


def slight(fit: Fit) -> list[str]:
    """Terms beside others that may as well not be there, by the errors of their numbers.

    These allow for errors that last and go with the place, of which the likelihoods that chose the
    terms know less.
    """
    law = fit.model.law
    sizes: dict[str, float] = {}
    for name, (value, error) in fit.numbers.items():
        kind = "uniform" if name in law.forces else name.split()[0]
        sizes[kind] = max(sizes.get(kind, 0.0), abs(value) / max(error, np.finfo(float).tiny))
    asked = law.frictions + (("uniform",) if law.restoring == "uniform" and law.frictions else ())
    return [kind for kind in asked if _seen(fit) and sizes.get(kind, np.inf) < CERTAIN]


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


def only_slows(fit: Fit) -> bool:
    """Whether a constant force only slows what a camera sees go straight, as dry friction does."""
    law = fit.model.law
    if law.restoring != "uniform" or law.frictions or law.walls or not law.pictured:
        return False
    if "collision" in fit.kinds:  # such bodies do not go straight
        return False
    rates = np.concatenate([r[:, 1] for r in fit.model.coordinates(fit.values, fit.clips)])
    speed = np.linalg.norm(rates, axis=-1)
    force = np.array([fit.numbers[name][0] for name in law.forces])
    return bool((rates @ force < -STRAIGHT * speed * np.linalg.norm(force)).all())


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
    return bool((swings**2 / (2 * lengths) < UNSEEN).all())


def _level(chart: Chart) -> bool:
    if not isinstance(chart, Line):
        return False
    x, y = chart.along
    return abs(y) < LEVEL * abs(x)


def in_short(kinds: Collection[str]) -> str:
    """Terms in a few words.

    Example:
        >>> in_short({"uniform", "linear"})
        'friction ~ v, constant acceleration'
    """
    return ", ".join(SHORT.get(kind, kind) for kind in sorted(kinds)) or "no force"


def rivals(mechanism: Mechanism) -> list[str]:
    """Of laws that are nearly as likely, in sentences."""
    out = []
    for group in mechanism.groups:
        kinds = {in_short(x.kinds) for x in near(group)}
        if kinds:
            said = "; or ".join(sorted(kinds))
            out.append(f"Nearly as likely: {said}. A longer recording would tell.")
        if shares := [SHORT[kind] for kind in slight(group.fit)]:
            said = ", ".join(shares)
            out.append(f"Hardly told from none: {said}. A longer recording would tell.")
        if may_hang(group.fit):
            out.append("A pendulum that swings as little moves alike. A wider swing would tell.")
        if unturned(group.fit):
            out.append(UNTURNED)
        if unrested(group.fit):
            out.append(UNRESTED)
        if only_slows(group.fit):
            out.append(SLOWS)
        if passes(group.fit):
            out.append(PASSES)
    return out
