"""The phone: where it stands, how it shakes and pans, and where its lens puts a point.

The world's x points right, y away from the camera and z up. A camera's axes are rows: right, up and
back. Pixels are counted from the centre of the upper left one, rows downwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

WAVES = 8  # of which a hand's tremor is made
SLOWEST, FASTEST = 0.3, 7.0  # Hz
FOLDED = 1.05  # times a picture's corner, that a barrel's rim is away at least


@dataclass(frozen=True)
class Lens:
    """A pinhole with radial distortion.

    Args:
        width, height: of the picture, pixels.
        focal: pixels.
        radial: of ``r' = r (1 + radial r^2)``, r in units of the focal length; below 0 is barrel.
    """

    width: int
    height: int
    focal: float
    radial: float

    @property
    def centre(self) -> np.ndarray:
        return np.array([self.width - 1, self.height - 1]) / 2

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels ``(…, 2)`` of points ``(…, 3)`` given along the camera's axes, metres."""
        flat = points[..., :2] / -points[..., 2:]
        bent = flat * (1 + self.radial * (flat**2).sum(-1, keepdims=True))
        return self.centre + self.focal * bent * [1, -1]

    @classmethod
    def within(cls, width: int, height: int, focal: float, radial: float) -> Lens:
        """With as much of a barrel as shows something in every corner.

        Its picture has a rim, 2 / 3 / sqrt(3 |radial|) from the middle; beyond it nothing is seen.
        """
        corner = FOLDED * float(np.hypot(width, height)) / 2 / focal
        return cls(width, height, focal, max(radial, -4 / 27 / corner**2))

    def rays(self) -> np.ndarray:
        """Where each pixel looks, ``(H, W, 3)`` along the camera's axes, one metre deep."""
        x, y = np.meshgrid(np.arange(self.width), np.arange(self.height))
        bent = (np.stack([x, y], -1) - self.centre) / self.focal * [1, -1]
        flat = bent * self._stretch(np.linalg.norm(bent, axis=-1, keepdims=True))
        return np.concatenate([flat, -np.ones((*flat.shape[:2], 1))], -1)

    def _stretch(self, far: np.ndarray) -> np.ndarray:
        """``r / r'`` at distances ``r'`` from the middle: the cubic's root nearest to zero."""
        part = np.maximum(1.5 * np.sqrt(3 * abs(self.radial)) * far, np.finfo(float).tiny)
        if self.radial > 0:
            return 3 * np.sinh(np.arcsinh(part) / 3) / part
        return 3 * np.sin(np.arcsin(np.minimum(part, 1)) / 3) / part


@dataclass(frozen=True)
class Tremor:
    """A smooth random motion: a sum of waves, each of three components.

    Args:
        size: ``(WAVES, 3)``; the unit is that of what moves.
        pulse: radians per second, ``(WAVES,)``.
        phase: radians, ``(WAVES, 3)``.
    """

    size: np.ndarray
    pulse: np.ndarray
    phase: np.ndarray

    @classmethod
    def of(cls, random: np.random.Generator, rms: float) -> Tremor:
        """One of a given root mean square in each component; slow waves are the larger."""
        hertz = np.exp(random.uniform(np.log(SLOWEST), np.log(FASTEST), WAVES))
        size = random.normal(size=(WAVES, 3)) / hertz[:, None]
        size *= rms / np.sqrt((size**2).sum(0) / 2)
        return cls(size, 2 * np.pi * hertz, random.uniform(0, 2 * np.pi, (WAVES, 3)))

    def at(self, times: np.ndarray) -> np.ndarray:
        """``(…, 3)`` at times ``(…)`` in seconds."""
        turns = self.pulse[:, None] * times[..., None, None] + self.phase
        return (self.size * np.sin(turns)).sum(-2)


@dataclass(frozen=True)
class Stand:
    """Where the camera is and how it moves.

    Args:
        position: metres, ``(3,)``.
        axes: ``(3, 3)``.
        turning: radians about the camera's right, up and back.
        pan: radians per second about its up, from the clip's middle on both sides.
        middle: seconds.
    """

    position: np.ndarray
    axes: np.ndarray
    turning: Tremor
    pan: float
    middle: float

    @property
    def turns(self) -> bool:
        """Whether it does not stay as it is."""
        return bool(self.pan) or bool(self.turning.size.any())

    def poses(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions ``(…, 3)`` and axes ``(…, 3, 3)`` at times ``(…)``."""
        angles = self.turning.at(times)
        angles[..., 1] += self.pan * (times - self.middle)
        turned = Rotation.from_rotvec(angles.reshape(-1, 3)).as_matrix() @ self.axes
        place = np.broadcast_to(self.position, (*times.shape, 3))
        return place, turned.reshape(*times.shape, 3, 3)


def look_at(
    target: np.ndarray, plane: np.ndarray, distance: float, tilt: float, side: float, roll: float
) -> tuple[np.ndarray, np.ndarray]:
    """Position and axes of a camera that looks at a point of a plane.

    Args:
        target: ``(3,)``.
        plane: its right, its up and its normal towards the camera, rows, ``(3, 3)``.
        distance: metres.
        tilt: radians between the camera's axis and the normal.
        side: radians; where the camera stands for that, 0 to the right, a quarter turn above.
        roll: radians about its own axis.
    """
    aside = np.cos(side) * plane[0] + np.sin(side) * plane[1]
    back = np.cos(tilt) * plane[2] + np.sin(tilt) * aside
    right = np.cross(plane[1], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    c, s = np.cos(roll), np.sin(roll)
    return target + distance * back, np.stack([c * right + s * up, c * up - s * right, back])


def along(points: np.ndarray, position: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """World points ``(…, 3)`` along a camera's axes."""
    return np.einsum("...ij,...j->...i", axes, points - position)
