"""One body: every chart with every law, and the one that the evidence is for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms.fit import fit, race
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.guesses import guesses
from vidphys.diagnose.mechanisms.law import FRICTIONS
from vidphys.diagnose.mechanisms.walled import walled

FAR = 100.0  # of log likelihood: a base that is so much worse than the best has no friction tried
LIKELIER = (
    4.0  # of log likelihood after its price, by which a law must be better than a plainer one
)
NEARING = (
    10.0  # of log likelihood after its price, from which a body is believed to near the camera
)
VAGUE_RATE = 0.15  # of a stiffness: a standard error from which nothing was seen to swing
TURNS = 2.5  # radians of a swing that are seen at least
VAGUE = 0.5  # standard error of a restitution, from which no bounce tells of it


def fits_of(clips: Sequence[Frames], angles: bool, camera: bool = False) -> list[Fit]:
    """All laws that could be fitted to one body's motion, best first.

    Args:
        clips: of the body.
        angles: whether its coordinate is an angle in radians.
        camera: whether its places are in a picture about whose middle they are counted.
    """
    started = [guess for one in guesses(clips, angles) for guess in (one, *walled(clips, one))]
    bases = race(clips, [(guess.model, guess.values) for guess in started])
    if not bases:
        return []
    best = max(base.score for base in bases)
    found = []
    for base in bases:
        found.append(base)
        if base.score > best - FAR:
            found += [x for x in _variants(clips, base, camera) if x is not None]
    return ranked(_near_surely([x for x in found if _makes_sense(x)]))


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
    near = [x for x in ordered if x.score > ordered[0].score - LIKELIER]
    plainest = min(near, key=_plain)
    return [plainest, *(x for x in ordered if x is not plainest)]


def _plain(found: Fit) -> tuple[int, int]:
    """How much a law asks for: its numbers, and a friction that is not the usual one.

    What swings slowly loses by a friction that goes with its speed, what falls through air by one
    that goes with its square.
    """
    law = found.model.law
    usual = "linear" if law.restoring in ("trap", "pendulum") else "square"
    return len(found.covariance), int(law.friction not in ("none", usual))


def _variants(clips: Sequence[Frames], base: Fit, camera: bool) -> list[Fit | None]:
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
    return out


def _usual_speed(base: Fit) -> float:
    rates = [x[:, 1] for x in base.model.coordinates(base.values, base.clips)]
    squared = np.concatenate([(x**2).sum(-1) for x in rates])
    return float(np.sqrt(squared.mean())) or 1.0


def _makes_sense(found: Fit) -> bool:
    """Whether its numbers mean what their names say, and are told by what was seen."""
    lasts = max(float(clip.times[-1]) for clip in found.clips)
    for name, (value, error) in found.numbers.items():
        if name.startswith(("stiffness", "swing")):
            if not (value > 0 and error < VAGUE_RATE * value and value * lasts**2 > TURNS**2):
                return False
        elif name in ("square", "dry") and not value > 0:
            return False
        elif name.startswith("restitution"):
            if not (0 <= value < 1 + 2 * error and error < VAGUE):
                return False
        elif name == "linear" and value < 0:  # a drive, which the menu tells of
            return False
    return True
