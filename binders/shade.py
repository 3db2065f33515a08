"""What is but the background in other light: a shadow, or the place that one has left."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from binders.base import Pictures
from binders.follow import MOST, Candidate
from binders.hypotheses import Hypothesis

INNER = 0.7  # of its radius, within which its soft edge does not count
LEAST = 12  # pixels of it in a frame
DARK = 0.8  # of the light of what it falls on, that a shadow leaves at most
UNLIKE = 0.12  # of its colours, by which they may differ from the background's in that light
OWN = 0.7  # of what they differ by from one colour of its own


def shadows(
    candidates: list[Candidate], frames: Pictures, background: Float[np.ndarray, "h w 3"]
) -> set[int]:
    """Which of the likeliest candidates are the background in other light, all the time.

    It has less where a shadow is; where a shadow lies mostly, it has more when that is away.

    A grey body before a grey wall is also as the wall is in less light; but what it passes does
    not show in it. So no colour of its own may explain its pixels as well.

    Args:
        candidates: as they were followed, pixels of the frames.
        frames: before a still camera.
        background: what stands still in them.
    """
    found = enumerate(candidates[:MOST])
    return {k for k, each in found if _seen_through(each.body, frames, background)}


def _seen_through(body: Hypothesis, frames: Pictures, background: np.ndarray) -> bool:
    pairs = [
        pair
        for t in np.flatnonzero(body.seen)
        if len((pair := _inside(body, int(t), frames[t], background))[0]) >= LEAST
    ]
    if not pairs:
        return False
    shown, behind = (np.concatenate(some) for some in zip(*pairs, strict=True))
    light = (shown * behind).sum() / max((behind * behind).sum(), 1.0)
    unlike = [np.sqrt(_power(a - light * b) / _power(a)) for a, b in pairs]
    own = _power(shown - np.median(shown, axis=0))
    through = _power(shown - light * behind)
    other = light < DARK or light > 1 / DARK
    return bool(other and np.median(unlike) < UNLIKE and through < OWN**2 * own)


def _inside(
    body: Hypothesis, frame: int, image: np.ndarray, background: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Its pixels in a frame, and the background's at the same places, ``(k, 3)`` each."""
    x, y = body.positions[frame]
    radius = INNER * body.radius[frame]
    if not np.isfinite(radius):
        radius = INNER * float(np.nanmedian(body.radius))
    high, wide = background.shape[:2]
    left, top = max(int(x - radius), 0), max(int(y - radius), 0)
    right, low = min(int(x + radius) + 2, wide), min(int(y + radius) + 2, high)
    rows, columns = np.ogrid[top:low, left:right]
    within = (columns - x) ** 2 + (rows - y) ** 2 <= radius**2
    part = np.s_[top:low, left:right]
    return image[part][within].astype(float), background[part][within].astype(float)


def _power(colours: np.ndarray) -> float:
    return float((colours**2).sum(-1).mean()) + 1e-9
