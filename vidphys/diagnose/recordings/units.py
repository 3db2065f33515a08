"""What positions are counted in, for people: pixels, metres, radians, or nothing that is known."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

Place = tuple[float, float]
Ends = tuple[Place, Place]
NUMBER = r"[-+]?[\d.]+(?:e[-+]?\d+)?"
SCALE = re.compile(
    rf"\s*({NUMBER})\s*([a-zµ]+)\s*=\s*({NUMBER}),({NUMBER})\s+({NUMBER}),({NUMBER})\s*", re.I
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
    """

    name: str = ""
    per: float = 1.0
    gravity: float | None = None
    ends: Ends | None = None

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
        """The unit of a number that goes with powers of length and of seconds."""
        parts = [(name, p) for name, p in ((self.name, length), ("s", seconds)) if name and p]
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
        text: the length, its unit, and the two pixels (column, row) that it lies between.
        size: (height, width) of the picture, pixels.

    Raises:
        ValueError: it says something else, or its pixels are one.
    """
    found = SCALE.fullmatch(text)
    if found is None:
        raise ValueError("write LENGTH UNIT = X1,Y1 X2,Y2, for example 0.30 m = 10,200 310,200")
    x1, y1, x2, y2 = (float(x) for x in found.groups()[2:])
    length = float(found.group(1))
    if not (length > 0 and (x1, y1) != (x2, y2)):
        raise ValueError("the length and the way between its two pixels must be above 0")
    return known_between(length, found.group(2), ((x1, y1), (x2, y2)), size)


def known_between(length: float, unit: str, pixels: Ends, size: tuple[int, int]) -> Units:
    """Units from a length between two pixels (column, row) of a picture of (height, width)."""
    (height, width), half = size, max(size) / 2
    one, other = (
        ((column - (width - 1) / 2) / half, ((height - 1) / 2 - row) / half)
        for column, row in pixels
    )
    return Units(unit, length / math.dist(one, other), ends=(one, other))
