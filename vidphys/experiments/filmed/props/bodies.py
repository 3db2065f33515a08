"""The bodies, what they hang from, and the fixtures around them."""

from __future__ import annotations

import numpy as np

from vidphys.experiments.filmed.props.pieces import Piece, between, box, turned
from vidphys.experiments.filmed.scenes.scene import Fixture, Look

BEHIND = 0.1  # metres that stands are behind the plane of motion
COILS, CORNERS = 14, 6  # of a spring
COIL_RADIUS, WIRE = 0.009, 0.0014
RADII = {"string": 0.0016, "rod": 0.0045}


def body(look: Look, skin: str) -> list[Piece]:
    """The pieces of a body about its centre; those of a disc lie on a table."""
    r = look.radius
    if look.shape == "ball":
        return [Piece("sphere", (r,), skin)]
    if look.shape == "weight":
        return [
            Piece("cylinder", (r * 0.8, r), skin),
            Piece("cylinder", (r * 0.25, r * 0.2), "metal", np.array([0, 0, r * 1.1])),
        ]
    if look.shape == "disc":
        mark = Piece("cylinder", (r * 0.22, 0.001), "mark", np.array([r * 0.55, 0, 0.0125]))
        return [Piece("cylinder", (r, 0.012), skin), mark]
    if look.shape == "cup":
        return [
            Piece("ellipsoid", (r, r, r * 0.35), skin),
            Piece("ellipsoid", (r * 0.6, r * 0.6, r * 0.3), skin, np.array([0, 0, -r * 0.25])),
        ]
    if look.shape == "cart":
        lying = turned(x=np.pi / 2)
        wheels = [
            Piece("cylinder", (r * 0.4, 0.006), "rubber", np.array([x, -r * 0.9, -r * 0.6]), lying)
            for x in (-r * 0.8, r * 0.8)
        ]
        return [box((2.6 * r, 1.6 * r, r), (0, 0, 0), skin), *wheels]
    raise ValueError(f"body: no shape {look.shape}")


def reach(look: Look) -> float:
    """Metres from a body's centre to where a spring is fixed to it."""
    return look.radius * (1.3 if look.shape == "cart" else 1.0)


def extent(look: Look) -> float:
    """Metres from a body's centre to its farthest point; a cart's is on a wheel."""
    return look.radius * (1.4 if look.shape == "cart" else 1.0)


def coil(a: np.ndarray, b: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Corners ``(COILS * CORNERS + 1, 3)`` of a spring from one point to another.

    Args:
        a, b: ``(3,)``.
        axes: whose third is from the one to the other.
    """
    steps = np.linspace(0, 1, COILS * CORNERS + 1)
    turn = 2 * np.pi * COILS * steps
    out = COIL_RADIUS * np.minimum(1, 12 * np.minimum(steps, 1 - steps))
    round_it = np.stack([out * np.cos(turn), out * np.sin(turn), np.zeros_like(turn)], -1)
    return a + (b - a) * steps[:, None] + round_it @ axes.T


def fixture(kind: Fixture, floor: float, wall: float, bracket: bool) -> list[Piece]:
    """The pieces of a fixture.

    Args:
        kind: see :class:`Fixture`.
        floor: height, metres.
        wall: metres behind the plane of motion.
        bracket: whether a stand is a bracket on the wall rather than a pole on the floor.
    """
    (ax, az), (bx, bz) = kind.a, kind.b
    if kind.kind == "stand":
        return _bracket(ax, bx, az, wall) if bracket else _pole(ax, bx, az, floor)
    if kind.kind == "wall":
        height = bz - az + 0.02
        return [box((0.02, 0.12, height), (ax, 0.0, az + height / 2), "metal")]
    if kind.kind == "rail":
        middle, long = (ax + bx) / 2, abs(bx - ax)
        table = box((long + 0.5, 0.6, 0.04), (middle, 0.1, az - 0.05), "wood")
        return [box((long, 0.06, 0.03), (middle, 0.0, az - 0.015), "metal"), table]
    if kind.kind == "ramp":
        return _ramp(np.array([ax, az]), np.array([bx, bz]), floor)
    return []  # the floor is the room's


def _bracket(a: float, b: float, height: float, wall: float) -> list[Piece]:
    bars = [between((x, -0.02, height), (x, wall, height), 0.008, "metal") for x in sorted({a, b})]
    foot = box((abs(b - a) + 0.1, 0.03, 0.08), ((a + b) / 2, wall - 0.015, height), "metal")
    return [*bars, foot]


def _pole(a: float, b: float, height: float, floor: float) -> list[Piece]:
    aside = min(a, b) - 0.06
    pieces = [
        between((aside, BEHIND, floor), (aside, BEHIND, height + 0.08), 0.008, "metal"),
        between((aside, BEHIND, height), (max(a, b) + 0.03, BEHIND, height), 0.006, "metal"),
        box((0.2, 0.14, 0.02), (aside, BEHIND, floor + 0.01), "rubber"),
    ]
    clamps = [between((x, -0.01, height), (x, BEHIND, height), 0.005, "metal") for x in {a, b}]
    return pieces + clamps


def _ramp(a: np.ndarray, b: np.ndarray, floor: float) -> list[Piece]:
    """A plank whose upper side is the line, on two feet."""
    way = b - a
    angle = float(np.arctan2(way[1], way[0]))
    if abs(angle) > np.pi / 2:
        way, a, angle = -way, b, float(np.arctan2(-way[1], -way[0]))
    axes = turned(y=-angle)
    middle = a + way / 2
    plank = box((np.hypot(*way), 0.12, 0.02), (0, 0, -0.01), "wood")
    pieces = [plank.at((middle[0], 0.0, middle[1]), axes)]
    for end in (a + 0.1 * way, a + 0.9 * way):
        height = max(end[1] - 0.03 - floor, 0.005)
        pieces.append(box((0.05, 0.1, height), (end[0], 0.0, floor + height / 2), "paint"))
    return pieces
