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
LIT = 0.5  # of the picture's edge beside a bar, that is not dark as a rule; a dark room has none


def without_bars(frames: Reel, sample: list[int]) -> Reel:
    """The frames with the picture's edge drawn on over the bars; as they are where there are none.

    Bars are on two opposite sides, or on all: one dark side is a part of the scene.

    Args:
        frames: RGB bytes ``(t, h, w, 3)``.
        sample: frames in which a bar must be dark.
    """
    import cv2

    brightest = np.stack([frames[k].max(-1) for k in sample])
    most, usual = brightest.max(0), np.median(brightest, axis=0) > DARK
    top, bottom = _bars(most.max(1) <= DARK, usual.mean(1))
    left, right = _bars(most.max(0) <= DARK, usual.mean(0))
    if not (top or left):
        return frames
    height, width = most.shape
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


def _bars(dark: np.ndarray, lit: np.ndarray) -> tuple[int, int]:
    """Pixels of the bars before and after the picture, along one side; none where it has none.

    Args:
        dark: which rows or columns are.
        lit: share of each that is not, as a rule.
    """
    shown = np.flatnonzero(~dark)
    if len(shown) <= 2 * RIM:
        return 0, 0
    first, last = int(shown[0]) + RIM, int(shown[-1]) - RIM
    before, after = first, len(dark) - 1 - last
    ends = min(lit[first], lit[last]) > LIT * lit.max()
    return (before, after) if ends and min(before, after) >= FEWEST + RIM else (0, 0)
