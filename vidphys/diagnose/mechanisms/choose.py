"""One body: every chart with every law, and the one that the evidence is for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.charts import Arc
from vidphys.diagnose.mechanisms.fit import fit, race
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.impacts.slack import slack
from vidphys.diagnose.mechanisms.impacts.spin import spun
from vidphys.diagnose.mechanisms.impacts.walled import walled
from vidphys.diagnose.mechanisms.ranking import ranked
from vidphys.diagnose.mechanisms.rubbed import rubbed
from vidphys.diagnose.mechanisms.sense import makes_sense, pulls_back, speeds_up
from vidphys.diagnose.mechanisms.starts.centre import centred
from vidphys.diagnose.mechanisms.starts.crosswise import crosswise
from vidphys.diagnose.mechanisms.starts.curved import curved
from vidphys.diagnose.mechanisms.starts.elastic import elastic, stretches
from vidphys.diagnose.mechanisms.starts.elliptic import elliptic
from vidphys.diagnose.mechanisms.starts.forced import forced
from vidphys.diagnose.mechanisms.starts.guesses import guesses
from vidphys.diagnose.mechanisms.starts.lift import lifted
from vidphys.diagnose.mechanisms.starts.spherical import spherical
from vidphys.diagnose.mechanisms.terms import FRICTIONS

FAR = 100.0  # of log likelihood: a base that is so much worse than the best has no friction tried
# of log likelihood after its price, from which a body is believed to near the camera
NEARING = 10.0
ABOVE = 0.5  # of its radius, that the pivot of what hangs is above it at least
BENT = 2.0  # times what an arc to the side leaves: what other laws leave, as a camera bends lines
LENS = 0.01  # of the spread, that a lens leaves at most of a law that holds in a clip


def roughly(clips: Sequence[Frames], angles: bool, like: Sequence[Fit] = ()) -> list[Fit]:
    """The laws that come nearest, each with a friction that goes with the speed, or a drive; and
    dry friction alone.

    Args:
        clips: of the body.
        angles: whether its coordinate is an angle in radians.
        like: laws to whose kinds it keeps; it tries all where none are given.
    """
    kinds = {_kind(x.model) for x in like}
    started = [guess for one in guesses(clips, angles) for guess in (one, *walled(clips, one))]
    runners = [(x.model, x.values) for x in started if not like or _kind(x.model) in kinds]
    bases = race(clips, runners)
    if not like or any(x.model.law.lift_fades is not None for x in like):
        bases += lifted(clips)
    if not angles and (not like or any(x.model.law.restoring == "none" for x in like)):
        bases += rubbed(clips)
    return bases


def _kind(model: Model) -> tuple[str, tuple[str, ...], bool]:
    """What pulls back, and how it shows; frictions and walls apart."""
    charts = model.charts
    aslant = any(isinstance(chart, Arc) and chart.aslant for chart in charts)
    return model.law.restoring, tuple(chart.name for chart in charts), aslant


def fits_of(
    clips: Sequence[Frames], angles: bool, camera: bool = False, alone: bool = True
) -> list[Fit]:
    """All laws that could be fitted to one body's motion, best first.

    Args:
        clips: of the body.
        angles: whether its coordinate is an angle in radians.
        camera: whether its places are in a picture about whose middle they are counted.
        alone: whether no other body was recorded, which may move it as what is not seen would.
    """
    bases = roughly(clips, angles)
    if not bases:
        return []
    best = max(base.score for base in bases)
    # Where no base is the law, what tells between them is not which of them comes nearest.
    open_ = not camera and not any(map(_tells_all, bases))
    found = []
    for base in bases:
        law = base.model.law
        varied = law.friction == "linear" and law.lift_fades is None  # lifts come with each
        near = base.score > best - FAR or (open_ and base.holds)
        if varied and near and pulls_back(base):
            started = pictured(clips, base) if camera else base
            found += [started, *_variants(clips, started, camera)]
        elif law.friction == "dry" and camera:
            found.append(pictured(clips, base))
        else:
            found.append(base)
    found += [x for x in (_smooth(clips, x) for x in found if speeds_up(x)) if x is not None]
    sensible = ranked(_hanging(_near_surely([x for x in found if makes_sense(x)])))
    others = _rarer(clips, sensible[:1], angles, camera, alone)
    others = [pictured(clips, x) if camera else x for x in others]
    spinning = spun(clips, sensible[0]) if sensible else None
    if spinning is None or makes_sense(spinning):
        return ranked([*sensible, *others, *([spinning] if spinning else [])])
    return [*ranked([*sensible, *others]), spinning]  # later frames may tell how it is gripped


def _rarer(
    clips: Sequence[Frames], best: Sequence[Fit], angles: bool, camera: bool, alone: bool
) -> list[Fit]:
    """Laws that are tried only where the best of the usual ones, if any, leaves something."""
    holds, all_told = (any(map(said, best)) for said in (_holds, _tells_all))
    told = _holds if camera else _tells_all  # what a lens leaves tells of no other law
    others: list[Fit] = []
    if not angles and not holds:
        others += [x for x in elliptic(clips) if makes_sense(x)]
    if alone and not any(map(_holds if camera else _follows, best)):
        others += [x for x in forced(clips, angles) if makes_sense(x)]
    round_it = any(map(_goes_round, best))  # or goes round on an orbit
    if not angles and (round_it or (best and not all_told and not any(map(told, others)))):
        others += centred(clips)
    if alone and not (angles or camera or any(map(told, best))):
        others += [x for x in spherical(clips) if makes_sense(x)]
    if alone and not (angles or camera or any(map(told, [*best, *others]))):
        others += [x for x in crosswise(clips) if makes_sense(x)]
    if alone and not (angles or camera or any(map(told, [*best, *others]))):
        springs = [x for x in elastic(clips) if makes_sense(x)]
        others += [x for x in springs if stretches(x) or not holds]  # else a rod holds it
    if alone and not (angles or any(map(_follows if camera else _tells_all, best))):
        others += [x for x in (*slack(clips), *curved(clips, best)) if makes_sense(x)]
    return others


def pictured(clips: Sequence[Frames], base: Fit) -> Fit:
    """The same law of bodies that a camera sees slightly askew; as it is, where that fails."""
    law = base.model.law
    if clips[0].stretches[0].places.shape[1] != view.FLAT:
        return base
    model = Model(replace(law, pictured=True), base.model.charts)
    values = np.insert(base.values, [len(law.names)] * len(view.NAMES), 0.0)
    return fit(clips, model, values) or base


def _smooth(clips: Sequence[Frames], base: Fit) -> Fit | None:
    """The same law with walls that take nothing along them."""
    law = base.model.law
    at = [i for i, name in enumerate(law.names) if name.startswith("along")]
    walls = tuple(replace(wall, smooth=True) for wall in law.walls)
    model = Model(replace(law, walls=walls), base.model.charts)
    return fit(clips, model, np.delete(base.values, at))


def _near_surely(fits: Sequence[Fit]) -> list[Fit]:
    """Without bodies that near the camera where they may as well not: a few frames of a flight
    are bent by both alike.
    """
    steady = max((x.score for x in fits if not x.model.law.nears), default=-np.inf)
    return [x for x in fits if not x.model.law.nears or x.score > steady + NEARING]


def _variants(clips: Sequence[Frames], base: Fit, camera: bool) -> list[Fit]:
    """The same with each other friction, and with none, from the base's numbers on.

    Args:
        camera: whether the positions are in a picture, whose bodies may near the camera.
    """
    law = base.model.law
    at = law.names.index("linear")
    rate = float(base.values[at])
    speed = _usual_speed(base)
    square, dry = abs(rate) / speed, abs(rate) * speed
    starts = {
        "none": [],
        "square": [square],
        "dry": [dry],
        "linear+dry": [0.5 * rate, 0.5 * dry],
        "linear+square": [0.5 * rate, 0.5 * square],
    }
    bare = np.delete(base.values, at)
    out = []
    for friction in FRICTIONS:
        if friction != "linear":
            values = np.insert(bare, at, starts[friction])
            other = replace(law, friction=friction)
            out.append(fit(clips, Model(other, base.model.charts), values))
    seen_apart = camera and len(clips) == 1 and law.coordinates == 2
    if seen_apart and law.restoring == "uniform" and base.model.charts[0].name == "plane":
        nears = Model(replace(law, friction="none", nears=True), base.model.charts)
        out.append(fit(clips, nears, np.insert(bare, at, -0.5 * rate)))
    return [x for x in out if x is not None]


def _usual_speed(base: Fit) -> float:
    rates = [x[:, 1] for x in base.model.coordinates(base.values, base.clips)]
    squared = np.concatenate([(x**2).sum(-1) for x in rates])
    return float(np.sqrt(squared.mean())) or 1.0


def _holds(found: Fit) -> bool:
    return found.holds


def _follows(found: Fit) -> bool:
    """Whether it leaves no more than a lens does."""
    return found.left < LENS * found.spread


def _tells_all(found: Fit) -> bool:
    """Whether it leaves nothing that lasts."""
    return found.errors.smooth <= found.errors.white


def _goes_round(found: Fit) -> bool:
    """Whether it goes over the top of its arc."""
    if not isinstance(found.model.charts[0], Arc):
        return False
    swings = [x[:, 0, 0] for x in found.model.coordinates(found.values, found.clips)]
    return max(float(np.ptp(x)) for x in swings) > 2 * np.pi


def _hanging(fits: Sequence[Fit]) -> list[Fit]:
    """Without arcs to the side of their pivots where a camera may as well bend another way so:
    what hangs is below its pivot.
    """
    least = min((x.left for x in fits if not _at_its_side(x)), default=np.inf)
    return [x for x in fits if not (_at_its_side(x) and least < BENT * x.left)]


def _at_its_side(found: Fit) -> bool:
    """Whether a camera sees a body on an arc whose pivot is not above it."""
    chart = found.model.charts[0]
    if not isinstance(chart, Arc) or not found.model.law.pictured:
        return False
    _, _, up = chart.vectors(found.geometry[0])
    return bool(up[1] < ABOVE * np.linalg.norm(up))
