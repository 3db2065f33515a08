"""What goes straight on at an even speed, or to and fro, as people walk: no force shows in it."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion

WINDOWS = 20  # side by side over the frames that show it, in each of which its velocity is told
EVEN = 0.2  # of its usual velocity, by which that of a window may differ
THIN = 0.05  # of the way along its line, that one that walks on it bobs up and down at most
SELDOM = 0.1  # of the windows, that are seldom
MOSTLY = 0.6  # of the windows, whose velocity is the usual one: in the others it turns back


def passes_by(motion: Motion, body: int) -> bool:
    """Whether a followed thing keeps to one line and one speed, but for turning back.

    Beside a body that a force moves it is a bystander. By itself it may be a body that nothing
    pulls, so that only the company tells. What sinks may be a body that falls as fast as air lets
    it.

    Args:
        motion: of one clip.
        body: which of the things.
    """
    seen = motion.seen[0, :, body]
    path, rates = motion.positions[0, seen, body], _rates(motion, body)
    if len(rates) < 2:
        return False
    ahead = rates * np.where(_back(rates), -1.0, 1.0)[:, None]
    usual = np.median(ahead, 0)
    if abs(usual[1]) > abs(usual[0]) and path[-1, 1] < path[0, 1]:
        return False
    line = usual / max(float(np.linalg.norm(usual)), np.finfo(float).tiny)
    along, across = np.ptp(path @ line), np.ptp(path @ [-line[1], line[0]])
    off = ahead - usual
    far = np.abs(off @ line) if across < THIN * along else np.linalg.norm(off, axis=-1)
    return bool((far <= EVEN * np.linalg.norm(usual)).mean() >= MOSTLY)


def turns_back(motion: Motion, body: int) -> bool:
    """Whether what passes by goes to and fro, as people do whom nothing turns round."""
    return passes_by(motion, body) and SELDOM < _back(_rates(motion, body)).mean() < 1 - SELDOM


def _rates(motion: Motion, body: int) -> np.ndarray:
    """Velocity in each window ``(w, d)``."""
    seen = motion.seen[0, :, body]
    path, times = motion.positions[0, seen, body], motion.times[0, seen]
    size = max(LEAST_FRAMES, len(path) // WINDOWS)
    starts = range(0, len(path) - size + 1, max(1, size // 2))
    return np.array([_rate(path[k : k + size], times[k : k + size]) for k in starts])


def _back(rates: np.ndarray) -> np.ndarray:
    """In which windows it goes one way and not the other."""
    return rates @ np.linalg.svd(rates, full_matrices=False)[2][0] < 0


def _rate(path: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Velocity of places ``(t, d)`` by a straight line through them."""
    since = times - times.mean()
    return since @ (path - path.mean(0)) / (since @ since)
