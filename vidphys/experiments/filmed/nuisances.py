"""What a camera adds to a scene, and the parts of the set: mild effects, or one that is strong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Random = np.random.Generator
RATES = (30.0, 30.0, 30.0, 30000 / 1001, 25.0)  # frames per second


@dataclass(frozen=True)
class Nuisances:
    """Everything between a scene and its file.

    Args:
        tilt: degrees between the camera's axis and the normal of the plane of motion.
        side: degrees; where the camera stands for that, 0 to the right, 90 above.
        roll: degrees about its axis.
        shake: degrees, root mean square of a hand's tremor about each axis.
        pan: degrees per second.
        radial: of the lens; below 0 is barrel.
        readout: seconds from the first row to the last (rolling shutter).
        shutter: seconds that a frame is exposed (motion blur).
        drift: of the brightness over the clip, relative.
        noise: grey levels.
        crf: of H.264; larger is worse.
        doubled, dropped: shares of the frames.
        told: whether the stamps show the gap of a dropped frame.
        jitter: of a frame's time, root mean square, in intervals.
        clutter: whether other things move.
        rate: frames per second.
    """

    tilt: float = 0.0
    side: float = 0.0
    roll: float = 0.0
    shake: float = 0.0
    pan: float = 0.0
    radial: float = 0.0
    readout: float = 0.0
    shutter: float = 0.0
    drift: float = 0.0
    noise: float = 1.5
    crf: int = 20
    doubled: float = 0.0
    dropped: float = 0.0
    told: bool = True
    jitter: float = 0.0
    clutter: bool = False
    rate: float = 30.0


def _mild(random: Random) -> Nuisances:
    return Nuisances(
        tilt=random.uniform(0, 4),
        side=random.uniform(0, 180),
        roll=random.uniform(-1.5, 1.5),
        shake=random.uniform(0, 0.04),
        radial=random.uniform(-0.03, 0.03),
        readout=float(random.choice([0.0, 0.01])),
        drift=random.uniform(0, 0.04),
        noise=random.uniform(1, 3),
        crf=int(random.integers(18, 27)),
        rate=float(random.choice(RATES)),
    )


def _alone(random: Random, part: str) -> Nuisances:
    """One nuisance at its full strength; the rest is a good camera on a tripod."""
    alone = {
        "tilt": {"tilt": random.uniform(10, 30), "side": random.uniform(0, 180)},
        "shake": {"shake": random.uniform(0.15, 0.5)},
        "lens": {"radial": random.uniform(0.08, 0.25) * random.choice([-1, -1, 1])},
        "clutter": {"clutter": True},
        "exposure": {"drift": random.uniform(0.15, 0.4)},
        "pan": {"pan": random.uniform(0.5, 2.0) * random.choice([-1, 1])},
        "blur": {"shutter": random.uniform(1 / 90, 1 / 35)},
        "rolling": {"readout": random.uniform(0.015, 0.03)},
        "compression": {"crf": int(random.integers(30, 41)), "noise": random.uniform(2, 4)},
        "timing": _broken(random),
    }[part]
    return replace(Nuisances(), **alone)  # type: ignore[arg-type]


def _broken(random: Random) -> dict[str, object]:
    """Frames that come twice, not at all, or when they like."""
    kind = int(random.integers(3))
    if kind == 0:
        return {"doubled": random.uniform(0.03, 0.12)}
    if kind == 1:
        return {"dropped": random.uniform(0.03, 0.12), "told": bool(random.random() < 0.7)}
    return {"jitter": random.uniform(0.1, 0.25)}


MILD = "mild"
STRONG = ("tilt", "shake", "lens", "clutter", "exposure")
OTHER = ("pan", "blur", "rolling", "compression", "timing")
PARTS = (MILD, *STRONG, *OTHER)
ROUND = (*STRONG, *STRONG, OTHER[0], OTHER[1], *STRONG, OTHER[2], OTHER[3], OTHER[4])


def part_of(number: int) -> str:
    """The part that a clip belongs to: every other one is mild, the rest take turns."""
    return MILD if number % 2 == 0 else ROUND[number // 2 % len(ROUND)]


def nuisances(random: Random, part: str) -> Nuisances:
    """Of a clip of a part."""
    return _mild(random) if part == MILD else _alone(random, part)
