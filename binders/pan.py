"""A camera that turns so far that the picture's parts move unlike: a homography for each frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8

from binders.points import followed

CORNERS = 400
QUALITY = 0.005  # of the best corner's
APART = 6  # pixels between corners
FEWEST = 12  # corners that tell a homography
EXACT = 1.0  # pixels, within which a corner goes with the background
AGREED = 0.6  # of the corners, that do
GLANCES = 9  # frames, that tell whether a camera turns far
TURNED = 0.04  # of the picture's shorter side, from which a camera turns far


def turning(frames: UInt8[np.ndarray, "t h w 3"]) -> Float[np.ndarray, "t 3 3"] | None:
    """Where the middle frame's background is in each frame; ``None`` if it stays nearly there.

    Most corners of the middle frame are its background's: what most of them agree on is what the
    camera did.

    Args:
        frames: RGB.

    Returns:
        Homographies that take pixels (x, y, 1) of the middle frame to those of each frame.
    """
    import cv2

    grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames]
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


def unturned(
    frames: UInt8[np.ndarray, "t h w 3"], turns: Float[np.ndarray, "t 3 3"]
) -> tuple[UInt8[np.ndarray, "t h w 3"], Bool[np.ndarray, "t h w"]]:
    """The frames as the middle one's camera would have seen them, and what of each it saw."""
    import cv2

    still, shown = np.empty_like(frames), np.empty(frames.shape[:3], bool)
    size = frames.shape[2], frames.shape[1]
    whole = np.ones(size[::-1], np.uint8)
    back = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for out, mask, frame, turn in zip(still, shown, frames, turns, strict=True):
        cv2.warpPerspective(frame, turn, size, out, flags=back)
        mask[:] = cv2.warpPerspective(whole, turn, size, flags=cv2.INTER_NEAREST | back) > 0
    return still, shown


def through(
    turns: Float[np.ndarray, "*t 3 3"], places: Float[np.ndarray, "*t n 2"]
) -> Float[np.ndarray, "*t n 2"]:
    """Where homographies take places, pixels."""
    bent = places @ np.swapaxes(turns[..., :2], -1, -2) + turns[..., None, :, 2]
    return bent[..., :2] / bent[..., 2:]
