"""What positions are counted in, for people: pixels, metres, radians, or nothing that is known."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.recordings.plane import Plane, plane_of

Place = tuple[float, float]
Ends = tuple[Place, Place]
NUMBER = r"[-+]?[\d.]+(?:e[-+]?\d+)?"
SCALE = re.compile(
    rf"\s*({NUMBER})(?:\s*[x×]\s*({NUMBER}))?\s*([a-zµ]+)\s*="
    rf"((?:\s+{NUMBER},{NUMBER}){{2}}|(?:\s+{NUMBER},{NUMBER}){{4}})\s*",
    re.I,
)
HOW = (
    "write LENGTH UNIT = X1,Y1 X2,Y2, for example 0.30 m = 10,200 310,200, or the sides of a "
    "rectangle and its corners, 2.2 x 1.1 m = X1,Y1 X2,Y2 X3,Y3 X4,Y4"
)
GRAVITY = 9.81  # m/s^2, at the ground


@dataclass(frozen=True)
class Units:
    """The unit in which lengths are told.

    Args:
        name: of it, or empty.
        per: of it in one unit of the positions.
        gravity: m/s^2, of what hangs or falls freely in the recording, where it is known: then
            such a body tells how long a metre is.
        ends: places in the picture between which the length lies that is known, where one is: a
            camera that sees the plane of motion askew shows it in another scale elsewhere.
        plane: of motion, where a rectangle in it is known: then positions are places in it.
    """

    name: str = ""
    per: float = 1.0
    gravity: float | None = None
    ends: Ends | None = None
    plane: Plane | None = None

    def told(self, value: float, length: int) -> float:
        """A number that goes with a power of length."""
        return value * self.per**length

    def length(self, value: float) -> str:
        """A length in words, of two digits."""
        told = self.told(value, 1)
        return (
            f"{told:.0f} {self.name}".rstrip()
            if told >= 100
            else f"{told:.2g} {self.name}".rstrip()
        )

    def named(self, length: float, seconds: int) -> str:
        """The unit of a number that goes with powers of length and of seconds.

        Where the unit of length is not known, the word stands for it; a length itself has none.
        """
        if not self.name and (length, seconds) == (1, 0):
            return ""
        powers = ((self.name or "length", length), ("s", seconds))
        parts = [(name, power) for name, power in powers if power]
        above = " ".join(_raised(name, p) for name, p in parts if p > 0)
        under = "/".join(_raised(name, -p) for name, p in parts if p < 0)
        if not under:
            return above
        return f"{above or '1'}/{under}"


def _raised(name: str, power: float) -> str:
    if power == 1:
        return name
    if float(power).is_integer() and power < 10:
        return name + "⁰¹²³⁴⁵⁶⁷⁸⁹"[int(power)]
    return f"{name}^{power:.3g}"


def scale_of(text: str, size: tuple[int, int]) -> Units:
    """Units from a length that is known in the picture, such as ``0.30 m = 10,200 310,200``.

    Args:
        text: the length, its unit, and the two pixels (column, row) that it lies between; or both
            sides of a rectangle, and the pixels of its corners in order round it, of which the
            first two bound the first side.
        size: (height, width) of the picture, pixels.

    Raises:
        ValueError: it says something else, or its pixels are one, or bound no rectangle.
    """
    found = SCALE.fullmatch(text)
    if found is None:
        raise ValueError(HOW)
    pixels = [(float(x), float(y)) for x, y in (pair.split(",") for pair in found[4].split())]
    sides = [float(side) for side in (found[1], found[2]) if side]
    if len(pixels) != 2 * len(sides):
        raise ValueError(HOW)
    if not (min(sides) > 0 and len(set(pixels)) == len(pixels)):
        raise ValueError("the length and the way between its two pixels must be above 0")
    if len(sides) == 1:
        return known_between(sides[0], found[3], (pixels[0], pixels[1]), size)
    plane, per = plane_of(np.array(_normalised(pixels, size)), (sides[0], sides[1]))
    return Units(found[3], per, plane=plane)


def known_between(length: float, unit: str, pixels: Ends, size: tuple[int, int]) -> Units:
    """Units from a length between two pixels (column, row) of a picture of (height, width)."""
    one, other = _normalised(pixels, size)
    return Units(unit, length / math.dist(one, other), ends=(one, other))


def _normalised(pixels: Sequence[Place], size: tuple[int, int]) -> list[Place]:
    """Pixels (column, row) in units of half the picture's longer side, from its middle."""
    (height, width), half = size, max(size) / 2
    return [
        ((column - (width - 1) / 2) / half, ((height - 1) / 2 - row) / half)
        for column, row in pixels
    ]
