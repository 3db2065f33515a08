"""Black bars beside a picture, as a video has that was filmed upright or for another screen.

They stand while a hand-held camera moves, and their edges are steeper than all else: what looks for
the background would hold on to them.
"""

from __future__ import annotations

import numpy as np

from binders.reel import Reel, filled

DARK = 24  # brightness level, that nothing of a bar is above
FEWEST = 4  # pixels, across a bar
RIM = 2  # pixels beside it, that compression and shrinking mix with it


def without_bars(frames: Reel, sample: list[int]) -> Reel:
    """The frames with the picture's edge drawn on over the bars; as they are where there are none.

    Bars are on two opposite sides, or on all: one dark side is a part of the scene.

    Args:
        frames: RGB bytes ``(t, h, w, 3)``.
        sample: frames in which a bar must be dark.
    """
    import cv2

    dark = np.max([frames[k].max(-1) for k in sample], axis=0) <= DARK
    top, bottom = _bars(dark.all(1))
    left, right = _bars(dark.all(0))
    if not (top or left):
        return frames
    height, width = dark.shape
    return filled(
        cv2.copyMakeBorder(
            frame[top : height - bottom, left : width - right],
            top,
            bottom,
            left,
            right,
            cv2.BORDER_REPLICATE,
        )
        for frame in frames
    )


def _bars(dark: np.ndarray) -> tuple[int, int]:
    """Pixels of the bars before and after the picture, along one side; none where it is all dark.

    Args:
        dark: which rows or columns are.
    """
    lit = np.flatnonzero(~dark)
    if not len(lit):
        return 0, 0
    before, after = int(lit[0]), int(len(dark) - 1 - lit[-1])
    return (before + RIM, after + RIM) if min(before, after) >= FEWEST else (0, 0)
