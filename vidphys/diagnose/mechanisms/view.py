"""What a camera does to a plane that bodies move in: perspective and a lens, both slight."""

from __future__ import annotations

import numpy as np

NAMES = ("tilt 1", "tilt 2", "lens")
USUAL = (0.1, 0.1, 0.02)  # standard deviations: a plane tilted by 10 degrees, a phone's lens
FLAT = 2  # dimensions of the plane
ROUNDS = 4  # until a place in the picture agrees with what the lens makes of it
NEAREST = 0.05
FAR = 1.6  # tangent of a plane's turn over the slope of its distance, of a usual camera
ACROSS, UP = (-0.6, -0.3, 0.0, 0.3, 0.6), (-0.4, 0.0, 0.4)  # where a length may be known
STEP = 1e-3


def flat(places: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Places in the plane ``(…, 2)`` of those in the picture, in the scale of the picture's middle.

    Args:
        places: ``(…, 2)``, units of half the picture's longer side, counted from its middle.
        view: two slopes of the plane's distance, and the lens's distortion, ``(…, 3)``.
    """
    slopes, lens = view[..., :2], view[..., 2:]
    straight = places * (1 - lens * _dot(places, places))
    across = straight / np.maximum(1 + _dot(straight, slopes), NEAREST)
    return _along(across, slopes, _longer(view))


def seen(places: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Places in the picture ``(…, 2)`` of those in the plane, the inverse of :func:`flat`."""
    slopes, lens = view[..., :2], view[..., 2:]
    across = _along(places, slopes, 1 / _longer(view))
    straight = across / np.maximum(1 - _dot(across, slopes), NEAREST)
    out = straight
    for _ in range(ROUNDS if lens.any() else 0):
        out = straight / np.maximum(1 - lens * _dot(out, out), NEAREST)
    return out


def _dot(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", one, two)[..., None]


def _longer(view: np.ndarray) -> np.ndarray:
    """Times its length in the picture ``(…, 1)``, that a way along the plane's turn has there."""
    return np.sqrt(1 + FAR**2 * _dot(view[..., :2], view[..., :2]))


def _along(places: np.ndarray, slopes: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Places with their part along the plane's turn so many times as long."""
    square = np.maximum(_dot(slopes, slopes), np.finfo(float).tiny)
    return places + (times - 1) / square * _dot(places, slopes) * slopes


def enlarged(ends: np.ndarray, view: np.ndarray) -> float:
    """Times its length in the picture, that what lies between two places is in the plane.

    Args:
        ends: of it, in the picture, ``(2, 2)``.
        view: see :func:`flat`.
    """
    shown = float(np.linalg.norm(ends[1] - ends[0]))
    return float(np.linalg.norm(np.diff(flat(ends, view), axis=0))) / shown


def unevenness(view: np.ndarray) -> float:
    """By which share of itself a length in the picture is uncertain, as a standard deviation.

    A plane that is turned shows a length at another scale wherever it lies, and shorter along the
    turn; a lens does the first too. A length that is known, a ruler, may lie anywhere.

    Args:
        view: see :func:`flat`.
    """
    at = np.stack(np.meshgrid(ACROSS, UP), -1).reshape(-1, 1, 2)
    turns = np.linspace(0, np.pi, 4, endpoint=False)
    ways = STEP * np.stack([np.cos(turns), np.sin(turns)], -1)
    long = np.linalg.norm(flat(at + ways, view) - flat(at, view), axis=-1)
    return float(np.sqrt(np.mean(np.log(long / STEP) ** 2)))
