"""How far and in which frames the things that were followed in a clip move."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion

LITTLE = 0.3  # of another's extent: what goes less and comes to rest was not let go
SELDOM = 0.6  # of another body's frames
ALWAYS = 0.9  # of the frames, in which one is seen that does not come and go
MOSTLY = 0.85  # of the frames from its first on, in which one is seen that a hand let go
SETTLED = 0.3  # of the frames that show it, from which something stays that settles early
RELEASED = 0.6  # of the frames, after which a hand has let go
RESTS = 0.1  # of the extent of all of its motion, that it has at most from then on if it rests


def stay(motion: Motion, bodies: list[int]) -> list[int]:
    """Those that are seen in nearly all frames."""
    return [body for body in bodies if motion.seen[..., body].mean() > ALWAYS]


def stays_on(motion: Motion, body: int) -> bool:
    """Whether it is seen in nearly all frames from the first that shows it."""
    seen = motion.seen[0, :, body]
    return bool(seen.any() and seen[seen.argmax() :].mean() > MOSTLY)


def shown_enough(motion: Motion, body: int) -> bool:
    """Whether as many frames show a body as a force takes to be seen."""
    return int(motion.seen[:, :, body].sum()) >= LEAST_FRAMES


def seen_enough(motion: Motion, bodies: list[int]) -> list[int]:
    """Without those seen in far fewer frames than another: a body's shadow, or a piece of it."""
    seen = motion.seen.mean((0, 1))
    most = max((seen[body] for body in bodies), default=0.0)
    return [body for body in bodies if seen[body] > SELDOM * most]


def rests(motion: Motion, body: int) -> bool:
    """Whether it hardly moves any more when a hand has let go."""
    path = motion.positions[0, :, body]
    late = path[int(RELEASED * len(path)) :]
    return extent(late) < RESTS * extent(path)


def settled(motion: Motion, body: int) -> bool:
    """Whether it moves in the first few of the frames that show it, and then stays."""
    path = motion.positions[0, motion.seen[0, :, body], body]
    return extent(path[int(SETTLED * len(path)) :]) < RESTS * float(np.ptp(path, axis=0).max())


def not_at_rest(motion: Motion, bodies: list[int], share: float = RESTS) -> list[int]:
    """Those that go at least such a share as far as the one that goes farthest."""
    extents = {body: extent(motion.positions[0, :, body]) for body in bodies}
    most = max(extents.values(), default=0.0)
    return [body for body in bodies if extents[body] >= share * most]


def extent(path: np.ndarray) -> float:
    """Of places ``(t, d)``, of which some are seen; the farthest few may be errors."""
    low, high = np.nanpercentile(path, [5, 95], axis=0) if np.isfinite(path).any() else (0.0, 0.0)
    return float(np.linalg.norm(np.subtract(high, low)))


def spread(path: np.ndarray) -> float:
    """Root mean square distance of places ``(t, d)`` from their mean."""
    return float(np.sqrt(np.nanvar(path, axis=0).sum()))
