"""How generalised coordinates show in the picture: a plane, a line, an arc about a pivot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vidphys.diagnose.mechanisms.curve import Curve


class Chart:
    """Places of a body from its coordinates; linear in a few numbers of geometry.

    Args of its methods are coordinates ``(…, k)``.
    """

    name = ""
    size = 1  # coordinates that it takes
    free = 0  # numbers beside its geometry that the recording drew it by

    def fixed(self, s: np.ndarray) -> np.ndarray:
        """What does not depend on the geometry, ``(…, d)``."""
        raise NotImplementedError

    def columns(self, s: np.ndarray) -> np.ndarray:
        """What goes with each number of the geometry, ``(…, d, m)``."""
        raise NotImplementedError

    def shown(self, s: np.ndarray, geometry: np.ndarray) -> np.ndarray:
        """Places ``(…, t, d)`` of coordinates ``(…, t, k)`` by a geometry ``(…, m)``."""
        columns = self.columns(s)
        if columns.shape[-1] == 0:
            return self.fixed(s)
        return self.fixed(s) + np.einsum("...dm,...m->...d", columns, geometry[..., None, :])


@dataclass(frozen=True)
class Plane(Chart):
    """The coordinates are the places themselves."""

    space: int
    name = "plane"

    @property
    def size(self) -> int:  # type: ignore[override]
        return self.space

    def fixed(self, s: np.ndarray) -> np.ndarray:
        return s

    def columns(self, s: np.ndarray) -> np.ndarray:
        return np.zeros((*s.shape, 0))


@dataclass(frozen=True)
class Turned(Chart):
    """The coordinates are places along two axes at a right angle, whose direction is nearly known.

    The geometry is the tangent of the angle by which they are turned from there; with it their
    unit grows by 1 / cos of that angle.

    Args:
        along: of the first axis, ``(2,)``, of length one.
    """

    along: tuple[float, float]
    name = "turned"
    size = 2

    @cached_property
    def axes(self) -> np.ndarray:
        """Row by row, ``(2, 2)``."""
        x, y = self.along
        return np.array([[x, y], [-y, x]])

    def fixed(self, s: np.ndarray) -> np.ndarray:
        return s @ self.axes

    def columns(self, s: np.ndarray) -> np.ndarray:
        x, y = self.axes
        return (s[..., :1] * y - s[..., 1:] * x)[..., None]

    def turned(self, geometry: np.ndarray) -> np.ndarray:
        """The axes as they are fitted, row by row ``(2, 2)``, of the length of a unit."""
        x, y = self.axes
        return np.stack([x + geometry[0] * y, y - geometry[0] * x])

    def degrees(self, geometry: np.ndarray) -> float:
        """From the first coordinate's way to the first axis, from -90 to 90."""
        x, y = self.turned(geometry)[0]
        return float(np.degrees(np.arctan(y / x))) if x else 90.0


@dataclass(frozen=True)
class Line(Chart):
    """A body on a line.

    Args:
        along: of the line, ``(d,)``, of length one; the coordinate is the place along it.
    """

    along: tuple[float, ...]
    name = "line"

    @cached_property
    def across(self) -> np.ndarray:
        """Directions across the line, ``(d, d - 1)``."""
        full = np.linalg.svd(np.array(self.along)[None])[2]
        return full[1:].T

    def fixed(self, s: np.ndarray) -> np.ndarray:
        return s * np.array(self.along)

    def columns(self, s: np.ndarray) -> np.ndarray:
        return np.concatenate([x[..., None] * self.across for x in (np.ones_like(s), s)], -1)


@dataclass(frozen=True)
class Bound(Chart):
    """A body on a curve that all of its places draw; the coordinate is the length along it."""

    curve: Curve
    name = "curve"

    @property
    def free(self) -> int:  # type: ignore[override]
        return self.curve.free

    def fixed(self, s: np.ndarray) -> np.ndarray:
        return self.curve.at(s[..., 0])

    def columns(self, s: np.ndarray) -> np.ndarray:
        return np.zeros((*s.shape[:-1], 2, 0))


@dataclass(frozen=True)
class Angle(Chart):
    """A table's angle, counted from where it hangs."""

    name = "angle"

    def fixed(self, s: np.ndarray) -> np.ndarray:
        return s

    def columns(self, s: np.ndarray) -> np.ndarray:
        return np.ones((*s.shape, 1))


@dataclass(frozen=True)
class Arc(Chart):
    """A body on a circle about a pivot, seen from the front or aslant.

    The geometry is the lowest point, and the two vectors of the circle's plane: along the arc
    there, and up. From the front they have one length, that of the string, and a right angle.

    Args:
        aslant: the circle may show as an ellipse.
    """

    aslant: bool = False
    name = "arc"

    def fixed(self, s: np.ndarray) -> np.ndarray:
        return np.zeros((*s.shape[:-1], 2))

    def columns(self, s: np.ndarray) -> np.ndarray:
        x, y = np.sin(s[..., 0]), 1 - np.cos(s[..., 0])
        out = np.zeros((*s.shape[:-1], 2, 6 if self.aslant else 4))
        out[..., 0, 0] = out[..., 1, 1] = 1.0
        out[..., 0, 2] = out[..., 1, 3] = x
        if self.aslant:
            out[..., 0, 4] = out[..., 1, 5] = y
        else:
            out[..., 1, 2], out[..., 0, 3] = y, -y
        return out

    def vectors(self, geometry: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The lowest point, the vector along the arc there, and the one up to the pivot."""
        if self.aslant:
            return geometry[:2], geometry[2:4], geometry[4:6]
        a, b = geometry[2:]
        return geometry[:2], np.array([a, b]), np.array([-b, a])

    def pivot(self, geometry: np.ndarray) -> np.ndarray:
        """Where the string hangs."""
        lowest, _, up = self.vectors(geometry)
        return lowest + up

    def slant(self, geometry: np.ndarray) -> float:
        """Tangent of the angle at which the circle's plane is seen; from the front it is 0."""
        long, short = np.linalg.svd(np.stack(self.vectors(geometry)[1:]))[1]
        return float(np.sqrt(max(long**2 - short**2, 0.0)) / max(short, np.finfo(float).tiny))

    def length(self, geometry: np.ndarray) -> float:
        """Of the string, unit of the positions: the longer of the two, because slant shortens."""
        _, along, up = self.vectors(geometry)
        return float(max(np.linalg.norm(along), np.linalg.norm(up)))
