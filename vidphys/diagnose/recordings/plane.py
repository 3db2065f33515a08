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
        matrix: from the plane's places to the picture's, homogeneous, ``(3, 3)``.
    """

    matrix: np.ndarray

    def shown(self, places: np.ndarray) -> np.ndarray:
        """Places in the picture ``(…, 2)`` of those in the plane."""
        return _mapped(self.matrix, places)

    def flat(self, places: np.ndarray) -> np.ndarray:
        """Places in the plane ``(…, 2)`` of those in the picture."""
        return _mapped(np.linalg.inv(self.matrix), places)


def _mapped(matrix: np.ndarray, places: np.ndarray) -> np.ndarray:
    out = places @ matrix[:, :2].T + matrix[:, 2]
    return out[..., :2] / out[..., 2:]


def plane_of(corners: np.ndarray, sides: tuple[float, float]) -> tuple[Plane, float]:
    """The plane of a rectangle whose corners are seen in a picture, and the length of a unit in it.

    Its origin is in the middle of the picture, its axes are turned as little as may be from the
    picture's, and its unit is about as long as the picture's is at the rectangle.

    Args:
        corners: in the picture, in order round it, ``(4, 2)``, counted from its middle.
        sides: of the rectangle, the first from its first corner to its second.

    Raises:
        ValueError: corners that are no four-cornered figure without a corner that points inwards.
    """
    ways = np.roll(corners, -1, 0) - corners
    turns = [a[0] * b[1] - a[1] * b[0] for a, b in zip(ways, np.roll(ways, -1, 0), strict=True)]
    if abs(np.sign(turns).sum()) < 4 or np.abs(turns).min() < SLIM * (ways**2).sum(1).max():
        raise ValueError("give the corners in order round the rectangle, none between two others")
    on = CORNERS * sides * [1.0, np.sign(turns[0])]  # not mirrored
    middle = _mapped(np.linalg.inv(_homography(on, corners)), np.zeros(2))
    per, turn = _nearest_turn(_homography(on, corners), on.mean(0))
    on = (on - middle) @ turn.T / per
    return Plane(_homography(on, corners)), per


def _homography(places: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """By four places and where they are shown."""
    rows, told = [], []
    for (x, y), (u, v) in zip(places, shown, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        told += [u, v]
    return np.append(np.linalg.solve(rows, told), 1.0).reshape(3, 3)


def _nearest_turn(matrix: np.ndarray, place: np.ndarray) -> tuple[float, np.ndarray]:
    """How long a unit of the picture is at a place, about, and how the picture is turned there."""
    x, y, w = matrix @ [*place, 1.0]
    slope = (matrix[:2, :2] - np.outer([x, y], matrix[2, :2]) / w) / w
    left, sizes, right = np.linalg.svd(slope)
    return float(1 / np.sqrt(sizes.prod())), left @ right
