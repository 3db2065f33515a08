"""What is drawn on all frames of a clip, as a clock or a name, and stands while the picture moves.

Its edges are steeper than all else: what looks for the background would hold on to them.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

LEAST_SLOPE = 1.0  # brightness levels a pixel; what noise leaves in a median is below
MOVES = 0.6  # pixel, to and fro, by which a part's edges move at least where a camera drifts
MOST = 0.75  # of the parts move less than the usual: what is drawn may fill some
STANDS = 0.15  # of what the others move, below which an edge stands
CLEAR = 4.0, 2.0  # times the noise, and brightness levels: the least slope of edges that tell of it
PARTS, TELLING = (6, 8), 12  # of the picture, down and across; and edges of one that tell of it
STEEPEST = 0.95  # of a part's pixels, that are not
BESIDE = 7  # pixels, across what is left out for each: the next digit of a clock


def drawn_on(grey: Float[np.ndarray, "t h w"]) -> Bool[np.ndarray, "h w"]:
    """Where something is drawn on all frames, and what is next to it.

    How far an edge moves to and fro is how much its brightness changes, over its slope.

    Args:
        grey: brightness of a few frames, 0 to 255.
    """
    import cv2

    background = np.median(grey, axis=0)
    changes = ndimage.gaussian_filter(np.median(np.abs(grey - background), axis=0), 1.0)
    slope = np.hypot(*np.gradient(ndimage.gaussian_filter(background, 1.0)))
    flat = slope < LEAST_SLOPE
    noise = float(np.median(changes[flat] if flat.any() else changes))
    clear = slope >= CLEAR[0] * noise + CLEAR[1]
    moves = changes / np.maximum(slope, LEAST_SLOPE)
    edges = map(_edges, *map(_parts, (moves, slope, clear)))
    usual = [np.median(each) for each in edges if len(each) >= TELLING]
    most = float(np.quantile(usual, MOST)) if usual else 0.0
    drawn = clear & (moves < STANDS * most) & (most > MOVES)
    return cv2.dilate(drawn.astype(np.uint8), np.ones((BESIDE, BESIDE), np.uint8)).astype(bool)


def _parts(image: np.ndarray) -> list[np.ndarray]:
    """Of a picture, side by side."""
    down, across = PARTS
    return [part for row in np.array_split(image, down) for part in np.array_split(row, across, 1)]


def _edges(moves: np.ndarray, slope: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """How far the steepest edges of a part move, of those that tell of it."""
    return moves[clear & (slope >= np.quantile(slope, STEEPEST))]
