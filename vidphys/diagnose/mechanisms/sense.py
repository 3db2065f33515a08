"""Whether the numbers of a fitted law mean what their names say, and are told by what was seen."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.mechanisms.charts import Arc
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.starts.centre import told

VAGUE_RATE = 0.15  # of a stiffness: a standard error from which nothing was seen to swing
TURNS = 2.5  # radians of a swing that are seen at least
UNTOLD = 0.5  # of a friction: a standard error from which the recording does not tell of it
FLAT = 0.02  # radians from end to end, below which an arc is a line
MOVING = 6  # frames in which what dry friction stops is seen to move, at least
BRIEF = 3  # frames, in which a friction that stops a body takes most of its speed at least
STRAIGHT = 0.97  # of its way, that a body ends away from its beginning, which goes one way
VAGUE = 0.5  # standard error of a restitution, along a wall too, from which no bounce tells of it


def makes_sense(found: Fit) -> bool:
    """Whether its numbers mean what their names say, and are told by what was seen."""
    if speeds_up(found):
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
    if along and "dry" in law.frictions and goes_one_way(found):
        return False
    if "dry" in law.frictions and not _moves(found):
        return False
    if along and _brakes_at_once(found):
        return False
    return pulls_back(found) and told(found) and not _flat(found)


def speeds_up(found: Fit) -> bool:
    """Whether a ball that does not spin leaves a wall faster along it than it came: none can."""
    return any(
        abs(value) > 1 + 2 * error
        for name, (value, error) in found.numbers.items()
        if name.startswith("along")
    )


def pulls_back(found: Fit) -> bool:
    """Whether what pulls a body back, if anything does, shows in the recording."""
    lasts = max(float(clip.times[-1]) for clip in found.clips)
    return all(
        value > 0 and error < VAGUE_RATE * value and value * lasts**2 > TURNS**2
        for name, (value, error) in found.numbers.items()
        if name.startswith(("stiffness", "swing"))
    )


def goes_one_way(found: Fit) -> bool:
    """Whether a constant pull and dry friction cannot be told apart, as both lie along one line."""
    ways = [x[:, 0] for x in found.model.coordinates(found.values, found.clips)]
    long = sum(float(np.linalg.norm(np.diff(way, axis=0), axis=-1).sum()) for way in ways)
    return sum(float(np.linalg.norm(way[-1] - way[0])) for way in ways) > STRAIGHT * long


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
