"""A camera that turns so far that the picture's parts move unlike: a homography for each frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from binders.base import Pictures
from binders.points import followed, grey_of
from binders.reel import Masks, Reel, Through

CORNERS = 400
QUALITY = 0.005  # of the best corner's
APART = 6  # pixels between corners
FEWEST = 12  # corners that tell a homography
EXACT = 1.0  # pixels, within which a corner goes with the background
AGREED = 0.6  # of the corners, that do
GLANCES = 9  # frames, that tell whether a camera turns far
TURNED = 0.04  # of the picture's shorter side, from which a camera turns far


def turning(frames: Pictures) -> Float[np.ndarray, "t 3 3"] | None:
    """Where the middle frame's background is in each frame; ``None`` if it stays nearly there.

    Most corners of the middle frame are its background's: what most of them agree on is what the
    camera did.

    Args:
        frames: RGB.

    Returns:
        Homographies that take pixels (x, y, 1) of the middle frame to those of each frame.
    """
    import cv2

    grey = Through(frames, grey_of)
    middle = len(frames) // 2
    found = cv2.goodFeaturesToTrack(grey[middle], CORNERS, QUALITY, APART)
    if found is None or len(found) < FEWEST:
        return None
    first = found[:, 0]
    glances = np.unique([*np.linspace(0, len(frames) - 1, GLANCES).astype(int), middle]).tolist()
    paths = followed([grey[frame] for frame in glances], glances.index(middle), first)
    ends = _homographies(first, paths[[0, -1]])
    if ends is None:
        return None
    centre = np.array([[[frames.shape[2] / 2, frames.shape[1] / 2]]])
    moved = np.linalg.norm(through(ends, np.tile(centre, (2, 1, 1))) - centre, axis=-1)
    if moved.max() < TURNED * min(grey[0].shape):
        return None
    return _homographies(first, followed(grey, middle, first))


def _homographies(first: np.ndarray, paths: np.ndarray) -> np.ndarray | None:
    """Of each frame, ``(t, 3, 3)``; ``None`` where too few corners agree on one."""
    import cv2

    turns = np.empty((len(paths), 3, 3))
    for turn, path in zip(turns, paths, strict=True):
        seen = np.isfinite(path[:, 0])
        if seen.sum() < FEWEST:
            return None
        found, agree = cv2.findHomography(first[seen], path[seen], cv2.RANSAC, EXACT)
        if found is None or agree.mean() < AGREED:
            return None
        turn[:] = found
    return turns


def unturned(frames: Pictures, turns: Float[np.ndarray, "t 3 3"]) -> tuple[Reel, Masks]:
    """The frames as the middle one's camera would have seen them, and what of each it saw."""
    import cv2

    height, width = frames.shape[1:3]
    size, whole = (width, height), np.ones((height, width), np.uint8)
    still, shown = Reel((height, width, 3), np.dtype(np.uint8)), Masks((height, width))
    back = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for frame, turn in zip(frames, turns, strict=True):
        still.append(cv2.warpPerspective(frame, turn, size, flags=back))
        inside = cv2.warpPerspective(whole, turn, size, flags=cv2.INTER_NEAREST | back)
        shown.append(inside > 0)
    return still, shown


def through(
    turns: Float[np.ndarray, "*t 3 3"], places: Float[np.ndarray, "*t n 2"]
) -> Float[np.ndarray, "*t n 2"]:
    """Where homographies take places, pixels."""
    bent = places @ np.swapaxes(turns[..., :2], -1, -2) + turns[..., None, :, 2]
    return bent[..., :2] / bent[..., 2:]
