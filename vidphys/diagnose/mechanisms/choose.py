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
from vidphys.diagnose.mechanisms.rubbed import rubbed
from vidphys.diagnose.mechanisms.starts.centre import centred, told
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
LIKELIER = (
    4.0  # of log likelihood after its price, by which a law must be better than a plainer one
)
NEARING = (
    10.0  # of log likelihood after its price, from which a body is believed to near the camera
)
VAGUE_RATE = 0.15  # of a stiffness: a standard error from which nothing was seen to swing
TURNS = 2.5  # radians of a swing that are seen at least
LEVEL = 2.0  # times its height, that a way is wide which is level, nearly
UNTOLD = 0.5  # of a friction: a standard error from which the recording does not tell of it
FLAT = 0.02  # radians from end to end, below which an arc is a line
ABOVE = 0.5  # of its radius, that the pivot of what hangs is above it at least
BENT = 2.0  # times what an arc to the side leaves: what other laws leave, as a camera bends lines
# of log likelihood, by which a pull that only slows what coasts must be better than dry friction:
# in clips filmed for development it was better by up to 9 where there was dry friction
COASTING = 12.0
MOVING = 6  # frames in which what dry friction stops is seen to move, at least
BRIEF = 3  # frames, in which a friction that stops a body takes most of its speed at least
STRAIGHT = 0.97  # of its way, that a body ends away from its beginning, which goes one way
LENS = 0.01  # of the spread, that a lens leaves at most of a law that holds in a clip
VAGUE = 0.5  # standard error of a restitution, along a wall too, from which no bounce tells of it


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
        if varied and near and _pulls_back(base):
            started = pictured(clips, base) if camera else base
            found += [started, *_variants(clips, started, camera)]
        elif law.friction == "dry" and camera:
            found.append(pictured(clips, base))
        else:
            found.append(base)
    found += [x for x in (_smooth(clips, x) for x in found if _speeds_up(x)) if x is not None]
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


def _speeds_up(found: Fit) -> bool:
    """Whether a ball that does not spin leaves a wall faster along it than it came: none can."""
    return any(
        abs(value) > 1 + 2 * error
        for name, (value, error) in found.numbers.items()
        if name.startswith("along")
    )


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


def ranked(fits: Sequence[Fit]) -> list[Fit]:
    """Best first; of those that are nearly as likely, the plainest."""
    ordered = sorted(fits, key=lambda x: -x.score)
    if not ordered:
        return []
    clear = COASTING if _only_pulled_back(ordered[0]) else LIKELIER
    near = [x for x in ordered if x.score > ordered[0].score - clear]
    plainest = min(near, key=_plain)
    return [plainest, *(x for x in ordered if x is not plainest)]


def _plain(found: Fit) -> tuple[int, int]:
    """How much a law asks for: its numbers, and what would be a coincidence.

    What swings slowly loses by a friction that goes with its speed, what falls through air by one
    that goes with its square. A pull straight against a motion that it never turns round is rarer
    than dry friction.
    """
    law = found.model.law
    if law.restoring == "none" or (law.curve is not None and _goes_one_way(found)):
        return len(found.covariance), 0
    swings = law.restoring in ("trap", "pendulum") or law.curve is not None
    usual = "linear" if swings else "square"
    odd = law.friction not in ("none", usual) or _only_pulled_back(found)
    return len(found.covariance), int(odd)


def _only_pulled_back(found: Fit) -> bool:
    """Whether a constant pull only slows what coasts."""
    return found.model.law.restoring == "uniform" and _coasts(found)


def _coasts(found: Fit) -> bool:
    """Whether a body in a picture gets slower on its level way, and never turns round."""
    if not found.model.law.pictured or found.model.law.walls:
        return False
    paths = [s.places for clip in found.clips for s in clip.stretches]
    across, up = np.abs(np.concatenate([p - p[0] for p in paths])).max(0)
    rates = np.concatenate([x[:, 1] for x in found.model.coordinates(found.values, found.clips)])
    speed, ahead = np.linalg.norm(rates, axis=-1), rates @ rates[0]
    return bool(across > LEVEL * up and (np.diff(speed) <= 0).all() and (ahead >= 0).all())


def _goes_one_way(found: Fit) -> bool:
    """Whether a constant pull and dry friction cannot be told apart, as both lie along one line."""
    ways = [x[:, 0] for x in found.model.coordinates(found.values, found.clips)]
    long = sum(float(np.linalg.norm(np.diff(way, axis=0), axis=-1).sum()) for way in ways)
    return sum(float(np.linalg.norm(way[-1] - way[0])) for way in ways) > STRAIGHT * long


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


def _pulls_back(found: Fit) -> bool:
    """Whether what pulls a body back, if anything does, shows in the recording."""
    lasts = max(float(clip.times[-1]) for clip in found.clips)
    return all(
        value > 0 and error < VAGUE_RATE * value and value * lasts**2 > TURNS**2
        for name, (value, error) in found.numbers.items()
        if name.startswith(("stiffness", "swing"))
    )


def makes_sense(found: Fit) -> bool:
    """Whether its numbers mean what their names say, and are told by what was seen."""
    if _speeds_up(found):
        return False
    for name, (value, error) in found.numbers.items():
        if name in (*found.model.law.frictions, "lift") and not error < UNTOLD * abs(value):
            return False
        if name in ("square", "dry") and not value > 0:
            return False
        if name.startswith("restitution") and not (0 <= value < 1 + 2 * error and error < VAGUE):
            return False
        if name.startswith("grip") and not (abs(value) < 1 + 2 * error and error < VAGUE):
            return False
        if name == "linear" and value < 0:  # a drive, which the menu tells of
            return False
    law = found.model.law
    along = law.restoring == "uniform" and law.curve is None
    if along and "dry" in law.frictions and _goes_one_way(found):
        return False
    if "dry" in law.frictions and not _moves(found):
        return False
    if along and _brakes_at_once(found):
        return False
    return _pulls_back(found) and told(found) and not _flat(found)


def _brakes_at_once(found: Fit) -> bool:
    """Whether frictions bring it to a steady speed within a few frames, as an impact does."""
    rates = np.concatenate([x[:, 1] for x in found.model.coordinates(found.values, found.clips)])
    speed = float(np.linalg.norm(rates, axis=-1).mean())
    told = {name: value for name, (value, _) in found.numbers.items()}
    fades = told.get("linear", 0.0) + told.get("square", 0.0) * speed + told.get("dry", 0.0) / speed
    return fades * float(np.median(np.diff(found.clips[0].times))) * BRIEF > 1


def _moves(found: Fit) -> bool:
    """Whether it moves its bodies in more than the few frames that a tracker may be wrong in."""
    rates = [x[:, 1] for x in found.model.coordinates(found.values, found.clips)]
    return sum(int(v.any(-1).sum()) for v in rates) >= MOVING


def _flat(found: Fit) -> bool:
    """Whether its arc is so flat that it is a line."""
    if not isinstance(found.model.charts[0], Arc):
        return False
    swings = [x[:, 0, 0] for x in found.model.coordinates(found.values, found.clips)]
    return max(float(np.ptp(x)) for x in swings) < FLAT


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
