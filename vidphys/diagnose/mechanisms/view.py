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
        view: two slopes of the plane's distance, and the lens's distortion, ``(3,)``.
    """
    straight = places * (1 - view[2] * (places**2).sum(-1, keepdims=True))
    across = straight / np.maximum(1 + straight @ view[:2], NEAREST)[..., None]
    return _along(across, view[:2], _longer(view))


def seen(places: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Places in the picture ``(…, 2)`` of those in the plane, the inverse of :func:`flat`."""
    across = _along(places, view[:2], 1 / _longer(view))
    straight = across / np.maximum(1 - across @ view[:2], NEAREST)[..., None]
    out = straight
    for _ in range(ROUNDS if view[2] else 0):
        out = straight / np.maximum(1 - view[2] * (out**2).sum(-1, keepdims=True), NEAREST)
    return out


def _longer(view: np.ndarray) -> float:
    """Times its length in the picture, that a way along the plane's turn is in the plane."""
    return float(np.sqrt(1 + FAR**2 * (view[0] ** 2 + view[1] ** 2)))


def _along(places: np.ndarray, slopes: np.ndarray, times: float) -> np.ndarray:
    """Places with their part along the plane's turn so many times as long."""
    square = float(slopes @ slopes)
    if square == 0:
        return places
    return places + (times - 1) / square * (places @ slopes)[..., None] * slopes


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
