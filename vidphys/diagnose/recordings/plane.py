"""A plane that bodies move in, and that a camera sees from anywhere: a rectangle in it is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# the corners of a rectangle, in order round it, over its sides
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
SLIM = 1e-3  # of the square of its longest side in the picture, that a rectangle covers at least


@dataclass(frozen=True, eq=False)
class Plane:
    """The homography between a picture and a plane (Hartley and Zisserman 2004, section 2.3).

    Args:
        matrix: from the plane's places to the picture's, homogeneous, ``(3, 3)``; the last
            coordinate is above 0 of what lies before the camera.
    """

    matrix: np.ndarray

    def shown(self, places: np.ndarray) -> np.ndarray:
        """Places in the picture ``(…, 2)`` of those in the plane; NaN behind the camera."""
        return _mapped(self.matrix, places)

    def flat(self, places: np.ndarray) -> np.ndarray:
        """Places in the plane ``(…, 2)`` of those in the picture; NaN beyond its horizon."""
        return _mapped(np.linalg.inv(self.matrix), places)


def _mapped(matrix: np.ndarray, places: np.ndarray) -> np.ndarray:
    out = places @ matrix[:, :2].T + matrix[:, 2]
    return out[..., :2] / np.where(out[..., 2:] > 0, out[..., 2:], np.nan)


def plane_of(corners: np.ndarray, sides: tuple[float, float]) -> tuple[Plane, float]:
    """The plane of a rectangle whose corners are seen in a picture, and the length of a unit in it.

    Its origin is in the rectangle's middle, where its axes are turned as little as may be from the
    picture's, and its unit is about as long as the picture's.

    Args:
        corners: in the picture, in order round it, ``(4, 2)``.
        sides: of the rectangle, the first from its first corner to its second.

    Raises:
        ValueError: corners that are no four-cornered figure without a corner that points inwards.
    """
    ways = np.roll(corners, -1, 0) - corners
    turns = [a[0] * b[1] - a[1] * b[0] for a, b in zip(ways, np.roll(ways, -1, 0), strict=True)]
    if abs(np.sign(turns).sum()) < 4 or np.abs(turns).min() < SLIM * (ways**2).sum(1).max():
        raise ValueError("give the corners in order round the rectangle, none between two others")
    on = CORNERS * sides * [1.0, np.sign(turns[0])]  # not mirrored
    on -= on.mean(0)
    per, turn = _nearest_turn(_homography(on, corners))
    return Plane(_homography(on @ turn.T / per, corners)), per


def _homography(places: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """By four places and where they are shown."""
    rows, told = [], []
    for (x, y), (u, v) in zip(places, shown, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        told += [u, v]
    return np.append(np.linalg.solve(rows, told), 1.0).reshape(3, 3)


def _nearest_turn(matrix: np.ndarray) -> tuple[float, np.ndarray]:
    """How long a unit of the picture is at the origin, about, and how it is turned there."""
    slope = matrix[:2, :2] - np.outer(matrix[:2, 2], matrix[2, :2])  # its last number is 1
    left, sizes, right = np.linalg.svd(slope)
    return float(1 / np.sqrt(sizes.prod())), left @ right
