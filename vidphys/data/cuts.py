"""Cuts of a clip: frames at which the whole picture changes, as where two takes were joined."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

from binders.base import Pictures
from vidphys.data.formats.opencv import opencv

SIDE = 64  # pixels of the longer side, at which frames are compared
CHANGED = 15.0  # brightness levels, from which a pixel is another
WHOLE = 0.2  # share of the pixels that are, at a cut
SUDDEN = 4.0  # times the share in the frames around
AROUND = 3  # frames
BUMP = 0.25  # of the picture's sides, that a camera is pushed by at most
MOVES = 0.1  # of what changes in the liveliest frames, from which something moves in a frame
LIVELY = 0.9


def parts(frames: Pictures) -> list[tuple[int, int]]:
    """First frame of each part between cuts, and the one after its last.

    At a cut a large share of the picture changes from one frame to the next, far more than in the
    frames around it. What a camera does that is pushed, or an exposure that changes, is undone
    first.
    """
    small = _small(frames)
    share = np.array([_changed(a, b) for a, b in zip(small[:-1], small[1:], strict=True)])
    cuts = []
    for t in np.flatnonzero(share > WHOLE).tolist():
        around = np.r_[share[max(0, t - AROUND) : t], share[t + 1 : t + 1 + AROUND]]
        if share[t] > SUDDEN * around.max(initial=0.0) and _changed(*_alike(small, t)) > WHOLE:
            cuts.append(t + 1)
    return list(zip([0, *cuts], [*cuts, len(frames)], strict=True))


def liveliest(frames: Pictures, parts: list[tuple[int, int]]) -> int:
    """Which part has the most frames in which something moves; of equals the longest."""
    small = _small(frames)
    pairs = zip(small[:-1], small[1:], strict=True)
    change = np.array([np.abs(_apart(a, b)).mean(-1).max() for a, b in pairs])
    for first, _ in parts[1:]:
        change[first - 1] = 0.0
    moves = change > MOVES * np.quantile(change, LIVELY)
    return max(
        range(len(parts)),
        key=lambda k: (int(moves[parts[k][0] : parts[k][1] - 1].sum()), np.ptp(parts[k])),
    )


def _small(frames: Pictures) -> UInt8[np.ndarray, "t h w 3"]:
    cv2 = opencv()
    height, width = frames.shape[1:3]
    scale = min(1.0, SIDE / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    skip = max(1, int(1 / scale) // 4)  # of a large frame not every pixel is needed
    some = (np.ascontiguousarray(frame[::skip, ::skip]) for frame in frames)
    small = [cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in some]
    return np.stack(small)


def _apart(before: np.ndarray, after: np.ndarray) -> Float[np.ndarray, "h w 3"]:
    return after.astype(np.float32) - before.astype(np.float32)


def _changed(before: np.ndarray, after: np.ndarray) -> float:
    """Share of the pixels that are others."""
    return float((np.abs(_apart(before, after)).mean(-1) > CHANGED).mean())


def _alike(small: np.ndarray, t: int) -> tuple[np.ndarray, np.ndarray]:
    """Frame ``t``, and the next one as bright and as aimed as it, where they overlap."""
    cv2 = opencv()
    before, after = small[t].astype(np.float32), small[t + 1].astype(np.float32)
    after = after * (np.median(before) / max(float(np.median(after)), 1.0))
    (dx, dy), _ = cv2.phaseCorrelate(before.mean(-1), after.mean(-1))
    height, width = before.shape[:2]
    if max(abs(dx) / width, abs(dy) / height) > BUMP:
        return before, after
    back = np.array([[1, 0, -dx], [0, 1, -dy]], np.float32)
    moved = cv2.warpAffine(after, back, (width, height))
    inside = cv2.warpAffine(np.ones((height, width), np.float32), back, (width, height)) > 0.99
    return before[inside][None], moved[inside][None]
