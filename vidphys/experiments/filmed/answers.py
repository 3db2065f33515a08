"""The product's own way with a clip, told only of a ruler, and how its numbers are read."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from binders.motion import MotionBinder
from vidphys.data.video import ClipSelection
from vidphys.diagnose.mechanisms.bodies.lawful import of_lawful_bodies
from vidphys.diagnose.mechanisms.quantities import VAGUE
from vidphys.diagnose.recordings.clips import follow_clip
from vidphys.diagnose.recordings.units import known_between
from vidphys.diagnose.telling.answers import answer
from vidphys.experiments.filmed.truth import Ruler
from vidphys.statistics import NORMAL_95

HELD_OUT = 0.4  # of a clip, at its end
# Forces between bodies, whatever their shape; and two rods.
ALIKE = {"spring": "pair", "rest-length": "pair", "double pendulum": "chain"}
EXPLAINED, MOSTLY, NOT = "explained", "mostly explained", "not explained"


@dataclass(frozen=True)
class Told:
    """A number that the product tells.

    Args:
        value: SI.
        half: of the 95 % interval.
        known: whether it is an answer; where the interval reaches far to either side, as
            :data:`VAGUE` has it, the product says that the clip does not tell it.
    """

    value: float
    half: float
    known: bool


@dataclass(frozen=True)
class Answer:
    """What the product says of a clip; places in pixels.

    Args:
        track: of the bodies in each frame, for a camera that stays, ``(t, n, 2)``; NaN where one
            was not seen.
        kinds: terms that it names.
        status: explained, mostly explained or not explained.
        mechanism: its laws, as ``diagnosis.json`` has them; lengths in metres.
        forecast: times and places ``(t, n, 2)`` after the fitted part; ``None`` without one.
        seconds: that it took.
        why: it gives no answer, where it gives none.
        stays: whether the forecast is that the bodies stay, as no law foretells more.
    """

    track: np.ndarray
    kinds: frozenset[str]
    status: str
    mechanism: list[dict[str, Any]]
    forecast: tuple[np.ndarray, np.ndarray] | None
    seconds: float
    why: str = ""
    stays: bool = False


def ask(clip: Path, size: tuple[int, int], ruler: Ruler) -> Answer:
    """Follow the bodies of a clip and diagnose their motion; a refusal is an answer.

    Args:
        clip: the video.
        size: (height, width), pixels.
        ruler: that is seen, by which lengths are told.
    """
    (x1, y1), (x2, y2) = ruler.pixels.tolist()
    units = known_between(ruler.metres, "m", ((x1, y1), (x2, y2)), size)
    began = time.perf_counter()
    track = np.full((0, 1, 2), np.nan)
    try:
        followed = follow_clip(clip, ClipSelection(), MotionBinder(bodies=None))
        motion, _ = of_lawful_bodies(followed.motion)
        track = pixels_of(motion.positions[0], size)
        found = answer(motion, False, HELD_OUT, camera=True, units=units)
    except ValueError as error:
        return Answer(track, frozenset(), NOT, [], None, time.perf_counter() - began, str(error))
    rolled = found.rolled.get("model")
    return Answer(
        track,
        frozenset(ALIKE.get(kind, kind) for kind in found.data["terms"]),
        str(found.data["status"]),
        found.data.get("mechanism", []),
        None if rolled is None else (rolled[0], pixels_of(rolled[1], size)),
        time.perf_counter() - began,
        found.data["refused"] or "",
        found.stays,
    )


def pixels_of(places: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Pixels (column, row) of normalised image units."""
    height, width = size
    return places * (max(size) / 2) * [1, -1] + [(width - 1) / 2, (height - 1) / 2]


NAMES = {  # the truth's name -> the product's
    "omega": "rate",
    "damping": "linear friction",
    "drag": "square friction",
    "length": "length",
    "g": "acceleration",
    "acceleration": "acceleration",
    "deceleration": "dry friction",
    "restitution": "restitution",
    "mass_ratio": "mass ratio",
}
TURNS = ("arc", "angle")


def told(group: Mapping[str, Any], name: str, body: int) -> Told | None:
    """A number of the truth as a law of the product has it, SI; ``None`` where it has none.

    Args:
        group: of ``mechanism``.
        name: the truth's.
        body: of the product's, whose it is.
    """
    if name not in NAMES:
        return None
    theirs = NAMES[name]
    which = list(group["bodies"]).index(body) + 1
    quantities = group["quantities"]
    for said in (theirs, f"{theirs} {which}", f"{theirs} 1"):
        if said in quantities:
            break
    else:
        return None
    scale, vague, used = 1.0, 0.0, [quantities[said]]
    if name == "drag" and group["moves on"] in TURNS:  # of the angle: drag times length
        if "length" not in quantities:
            return None
        length = quantities["length"]
        used.append(length)
        scale = 1 / length["value"]
        vague = length["standard_error"] / length["value"]
    found = quantities[said]
    half = NORMAL_95 * float(np.hypot(found["standard_error"], vague * found["value"]))
    known = all(x["known"] for x in used) and half <= VAGUE * abs(found["value"])
    return Told(found["value"] * scale, half * scale, known)
