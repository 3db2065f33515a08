"""Pieces: simple shapes with a skin, and groups of them that move as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

UPRIGHT = np.eye(3)
Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Piece:
    """A shape with a skin.

    Args:
        shape: sphere, ellipsoid, box, cylinder or capsule, as MuJoCo means them.
        size: half sizes, metres.
        skin: name of a skin; see :class:`Skins`.
        place: of its centre, metres, ``(3,)``.
        axes: ``(3, 3)``; its own axes are the columns.
    """

    shape: str
    size: tuple[float, ...]
    skin: str
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))

    def at(self, place: Vector, axes: np.ndarray = UPRIGHT) -> Piece:
        """The same, carried by a frame."""
        return replace(
            self, place=np.asarray(place, float) + axes @ self.place, axes=axes @ self.axes
        )


@dataclass(frozen=True)
class Skin:
    """A texture by name, or a plain colour, with how it shines.

    Args:
        texture: of :data:`~vidphys.experiments.filmed.textures.TEXTURES`; none where empty.
        colour: ``(r, g, b)`` in 0..1.
        flat: whether it is spread over one side, rather than around a body.
        repeat: of the texture along that side.
        shine: 0..1.
    """

    texture: str = ""
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    flat: bool = False
    repeat: float = 1.0
    shine: float = 0.2


def between(a: Vector, b: Vector, radius: float, skin: str, shape: str = "capsule") -> Piece:
    """A round bar from one point to another."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    return Piece(shape, (radius, half_length(a, b)), skin, (a + b) / 2, pointing(b - a))


def half_length(a: np.ndarray, b: np.ndarray) -> float:
    """Of a bar from one point to another, metres; never nothing."""
    return max(float(np.linalg.norm(b - a)) / 2, 1e-4)


def pointing(way: np.ndarray) -> np.ndarray:
    """Axes whose third is along a vector."""
    third = way / max(float(np.linalg.norm(way)), 1e-12)
    other = np.array([1.0, 0.0, 0.0]) if abs(third[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = np.cross(other, third)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(third, first), third], 1)


def turned(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Axes after turns about x, y and z, radians."""
    return Rotation.from_euler("xyz", [x, y, z]).as_matrix()


def box(size: Vector, place: Vector, skin: str, axes: np.ndarray = UPRIGHT) -> Piece:
    """A box by its whole sizes."""
    half = tuple(float(s) / 2 for s in size)
    return Piece("box", half, skin, np.asarray(place, float), axes)
