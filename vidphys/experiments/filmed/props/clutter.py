"""Other things that move behind the motion that is filmed: a person, a cat, a fan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vidphys.experiments.filmed.props.pieces import Piece, between, turned

Random = np.random.Generator
CLUTTER = ("walker", "cat", "fan")


@dataclass(frozen=True)
class Mover:
    """A group of pieces with its way through the room.

    Args:
        pieces: about its own origin.
        start: metres, ``(3,)``.
        velocity: m/s, ``(3,)``; it turns back at the ends of its way.
        span: metres to each side of the start.
        bob: metres that it goes up and down, ``pace`` times a second.
        turns: revolutions per second about y.
    """

    pieces: list[Piece]
    start: np.ndarray
    velocity: np.ndarray
    span: float
    bob: float = 0.0
    pace: float = 0.0
    turns: float = 0.0

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Its place and axes at a time in seconds."""
        speed = float(np.linalg.norm(self.velocity))
        place = self.start.copy()
        if speed:
            phase = (speed * time / self.span + 1) % 4
            place = place + self.velocity / speed * self.span * (1 - abs(phase - 2))
        place[2] += self.bob * abs(np.sin(np.pi * self.pace * time))
        return place, turned(y=2 * np.pi * self.turns * time)


def movers(random: Random, floor: float, wall: float, half_width: float) -> list[Mover]:
    """One or two of them, behind the plane of motion.

    Args:
        random: which.
        floor: its height, metres.
        wall: metres behind the plane of motion.
        half_width: of what the camera sees, metres.
    """
    names = random.choice(CLUTTER, size=int(random.integers(1, 3)), replace=False)
    depth = 0.7 * wall
    found = []
    for name in names:
        x, way = random.uniform(-0.5, 0.5) * half_width, random.choice([-1, 1])
        span = half_width * random.uniform(0.6, 1.4)
        if name == "walker":
            speed = np.array([way * random.uniform(0.3, 0.8), 0, 0])
            found.append(Mover(_walker(), np.array([x, depth, floor]), speed, span, 0.03, 1.8))
        elif name == "cat":
            speed = np.array([way * random.uniform(0.15, 0.5), 0, 0])
            found.append(Mover(_cat(), np.array([x, depth, floor]), speed, span, 0.01, 3.0))
        else:
            place = np.array([x, wall - 0.08, floor + random.uniform(0.9, 1.5)])
            turns = random.uniform(0.3, 1.2)
            found.append(Mover(_fan(), place, np.zeros(3), 1.0, turns=turns))
    return found


def over_table(random: Random, reach: float) -> list[Mover]:
    """An arm that comes and goes at the rim of a table seen from above.

    Args:
        random: where.
        reach: metres from the origin within which it does not come.
    """
    side = float(random.choice([-1, 1]))
    arm = [
        Piece("ellipsoid", (0.045, 0.03, 0.02), "skin", np.array([0, 0, 0.03])),
        between((0.04, 0, 0.03), (0.2, 0, 0.04), 0.026, "skin"),
        between((0.15, 0, 0.04), (0.6, 0, 0.06), 0.038, "cloth"),
    ]
    start = np.array([random.uniform(0, 0.5) * reach, side * (reach + 0.03), 0.0])
    speed = np.array([random.uniform(0.08, 0.25), 0, 0])
    return [Mover(arm, start, speed, 0.4 * reach)]


def _walker() -> list[Piece]:
    legs = [between((x, 0, 0.05), (x * 0.7, 0, 0.8), 0.065, "paint1") for x in (-0.13, 0.13)]
    arms = [between((x, 0, 0.85), (x * 0.8, 0, 1.35), 0.05, "cloth") for x in (-0.26, 0.26)]
    return [
        *legs,
        *arms,
        Piece("ellipsoid", (0.2, 0.13, 0.34), "cloth", np.array([0, 0, 1.1])),
        Piece("ellipsoid", (0.09, 0.1, 0.12), "skin", np.array([0, 0, 1.58])),
        Piece("ellipsoid", (0.095, 0.105, 0.09), "rubber", np.array([0, 0.02, 1.64])),
    ]


def _cat() -> list[Piece]:
    legs = [between((x, 0, 0.0), (x, 0, 0.14), 0.016, "fur") for x in (-0.11, 0.11)]
    return [
        *legs,
        Piece("ellipsoid", (0.18, 0.06, 0.075), "fur", np.array([0, 0, 0.19])),
        Piece("ellipsoid", (0.055, 0.05, 0.05), "fur", np.array([0.19, 0, 0.27])),
        between((-0.17, 0, 0.22), (-0.3, 0, 0.36), 0.013, "fur"),
    ]


def _fan() -> list[Piece]:
    blades = [
        Piece("ellipsoid", (0.13, 0.005, 0.045), "white").at((0, 0, 0), turned(y=k * 2 * np.pi / 3))
        for k in range(3)
    ]
    moved = [b.at(b.axes @ np.array([0.12, 0, 0])) for b in blades]
    return [*moved, Piece("sphere", (0.035,), "metal")]
