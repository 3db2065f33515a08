"""The room or the table around the motion, with what people leave standing in it."""

from __future__ import annotations

import numpy as np

from vidphys.experiments.filmed.props.pieces import Piece, Skin, box, turned
from vidphys.experiments.filmed.textures import FLOORS, WALLS

Random = np.random.Generator
STRETCH = 6.0  # metres on a side of floor and wall, half
SPACED = 0.0017  # metres, by which one thing stands before another: two faces in one place flicker
SLAB = (STRETCH, STRETCH, 0.05)  # a box: the shadows of planes have holes


def skins(random: Random, bodies: int) -> dict[str, Skin]:
    """All skins of one scene by name."""
    some: dict[str, Skin] = {
        f"body{k}": Skin("ball", shine=random.uniform(0.1, 0.6)) for k in range(bodies)
    }
    some |= {f"poster{k}": Skin("poster") for k in range(3)}
    some |= {f"paint{k}": Skin("cloth", shine=0.1) for k in range(4)}
    return some | {
        "wall": Skin(str(random.choice(WALLS)), flat=True, repeat=random.uniform(5, 9), shine=0.05),
        "floor": Skin(
            str(random.choice(FLOORS)), flat=True, repeat=random.uniform(8, 14), shine=0.2
        ),
        "metal": Skin("metal", shine=0.7),
        "wood": Skin("wood", shine=0.2),
        "paint": Skin("cloth", shine=0.2),
        "rubber": Skin(colour=(0.08, 0.08, 0.09)),
        "mark": Skin(colour=tuple(random.choice([[0.95, 0.95, 0.9], [0.05, 0.05, 0.05]]))),
        "thread": Skin(colour=tuple(np.full(3, random.choice([0.15, 0.85])))),
        "skin": Skin("skin", shine=0.1),
        "cloth": Skin("cloth", shine=0.05),
        "ruler": Skin("ruler", shine=0.2),
        "fur": Skin("carpet", shine=0.05),
        "leaf": Skin(colour=(0.16, 0.36, 0.14)),
        "white": Skin(colour=(0.9, 0.9, 0.88)),
    }


def room(random: Random, floor: float, wall: float) -> list[Piece]:
    """A floor and a wall, with furniture against it.

    Args:
        random: what is there.
        floor: its height, metres.
        wall: metres behind the plane of motion.
    """
    back = turned(x=np.pi / 2)
    pieces = [
        Piece("box", SLAB, "floor", np.array([0, 0, floor - SLAB[2]])),
        Piece("box", SLAB, "wall", np.array([0, wall + SLAB[2], floor]), back),
        box((2 * STRETCH, 0.012, 0.1), (0, wall - 0.006, floor + 0.05), "white"),
    ]
    for k in range(int(random.integers(2, 6))):
        make = (_poster, _cabinet, _shelf, _plant, _door)[int(random.integers(5))]
        pieces += make(random, random.uniform(-2.2, 2.2), floor, wall - SPACED * k)
    return pieces


def _poster(random: Random, x: float, floor: float, wall: float) -> list[Piece]:
    w, h = random.uniform(0.25, 0.7, 2)
    place = (x, wall - 0.012, floor + random.uniform(0.9, 1.8))
    frame = box((w + 0.05, 0.016, h + 0.05), (place[0], wall - 0.008, place[2]), "rubber")
    return [frame, box((w, 0.02, h), place, f"poster{random.integers(3)}")]


def _cabinet(random: Random, x: float, floor: float, wall: float) -> list[Piece]:
    w, h, d = random.uniform(0.4, 0.9), random.uniform(0.4, 1.3), min(0.4, wall - 0.25)
    skin = str(random.choice(["wood", "white", "paint0", "paint1"]))
    pieces = [box((w, d, h), (x, wall - d / 2, floor + h / 2), skin)]
    for k in range(int(random.integers(1, 4))):  # handles
        z = floor + h * (k + 0.6) / 3.5
        pieces.append(box((0.12, 0.02, 0.015), (x, wall - d - 0.01, z), "metal"))
    lamp = np.array([x, wall - d / 2, floor + h + 0.12])
    return [*pieces, Piece("cylinder", (0.06, 0.12), f"paint{random.integers(4)}", lamp)]


def _shelf(random: Random, x: float, floor: float, wall: float) -> list[Piece]:
    z, long = floor + random.uniform(0.9, 1.7), random.uniform(0.5, 1.0)
    pieces = [box((long, 0.2, 0.025), (x, wall - 0.1, z), "wood")]
    at = x - long / 2 + 0.05
    while at < x + long / 2 - 0.05:
        w, h = random.uniform(0.02, 0.06), random.uniform(0.15, 0.28)
        skin = f"paint{random.integers(4)}"
        pieces.append(box((w, 0.15, h), (at + w / 2, wall - 0.1, z + 0.0125 + h / 2), skin))
        at += w + random.choice([0.003, 0.003, 0.09])
    return pieces


def _plant(random: Random, x: float, floor: float, wall: float) -> list[Piece]:
    depth = wall - min(0.25, wall / 3)
    pieces = [Piece("cylinder", (0.12, 0.14), "paint2", np.array([x, depth, floor + 0.14]))]
    for _ in range(14):
        out, turn, up = (
            random.uniform(0.05, 0.25),
            random.uniform(0, 6.3),
            random.uniform(0.35, 0.9),
        )
        place = np.array([x + out * np.cos(turn), depth + 0.4 * out * np.sin(turn), floor + up])
        axes = turned(random.uniform(-1, 1), random.uniform(-1, 1), turn)
        pieces.append(Piece("ellipsoid", (0.11, 0.035, 0.006), "leaf", place, axes))
    return pieces


def _door(random: Random, x: float, floor: float, wall: float) -> list[Piece]:
    skin = str(random.choice(["wood", "white"]))
    door = box((0.85, 0.03, 2.0), (x, wall - 0.015, floor + 1.0), skin)
    frame = box((1.0, 0.02, 2.08), (x, wall - 0.01, floor + 1.04), "white")
    knob = Piece("sphere", (0.03,), "metal", np.array([x + 0.35, wall - 0.06, floor + 1.0]))
    return [frame, door, knob]


def table(random: Random, reach: float) -> list[Piece]:
    """A table seen from above, things at its rim.

    Args:
        random: what is there.
        reach: metres from the origin within which it is kept free.
    """
    pieces = [Piece("box", SLAB, "floor", np.array([0, 0, -SLAB[2]]))]
    rim = reach + 0.12
    for k in range(int(random.integers(2, 6))):
        turn = random.uniform(0, 2 * np.pi)
        x, y = rim * np.cos(turn) * 1.5, rim * np.sin(turn)
        size = (*random.uniform(0.06, 0.22, 2), random.uniform(0.01, 0.05))
        thing = box(size, (0, 0, size[2] / 2), f"paint{k % 4}" if k % 2 else f"poster{k % 3}")
        pieces.append(thing.at((x, y, 0), turned(z=random.uniform(0, 3))))
    return pieces
