"""What trackers do to positions: noise with a memory, false finds, gaps, swapped names, pixels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

MEMORY = 0.8  # correlation of the error from frame to frame
FALSE_FINDS, FARTHEST = 0.02, 1.0  # share of the frames; world units
LOST, LONGEST_LOSS = 0.03, 6  # chance that a gap begins; frames
SWAPPED, KEPT, LEAST_APART = 0.5, 0.5, 4  # share of clips; for good; frames from either end

Measure = Callable[[np.ndarray, float, np.random.Generator], np.ndarray]


def white(path: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Independent normal errors. Path and result ``(e, t, n, d)``, as in all of these."""
    return path + sigma * rng.standard_normal(path.shape)


def remembering(path: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Errors of the same size that last: each is 0.8 of the last one, and something new."""
    fresh = rng.standard_normal(path.shape)
    error = fresh.copy()
    for frame in range(1, path.shape[1]):
        error[:, frame] = MEMORY * error[:, frame - 1] + np.sqrt(1 - MEMORY**2) * fresh[:, frame]
    return path + sigma * error


def false_finds(path: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Something else is taken for the body, anywhere near, in one frame of fifty."""
    wrong = rng.random(path.shape[:3]) < FALSE_FINDS
    return np.where(wrong[..., None], path + rng.uniform(-FARTHEST, FARTHEST, path.shape), path)


def gaps(path: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Bodies are lost for one to six frames in a row."""
    out = path.copy()
    for clip, frame, body in np.argwhere(rng.random(path.shape[:3]) < LOST):
        out[clip, frame : frame + rng.integers(1, LONGEST_LOSS + 1), body] = np.nan
    return out


def swaps(path: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Where two bodies come nearest their names are swapped, for good or for a while."""
    out, (clips, frames, bodies, _) = path.copy(), path.shape
    for clip in range(clips):
        if bodies < 2 or rng.random() > SWAPPED:
            continue
        first, second = rng.choice(bodies, 2, replace=False)
        apart = np.linalg.norm(path[clip, :, first] - path[clip, :, second], axis=-1)
        inner = np.where(np.isfinite(apart), apart, np.inf)[LEAST_APART : frames - LEAST_APART]
        begin = LEAST_APART + int(inner.argmin())
        end = frames if rng.random() < KEPT else begin + int(rng.integers(4, 20))
        out[clip, begin:end, [first, second]] = path[clip, begin:end, [second, first]]
    return out


def in_pixels(path: np.ndarray, sigma: float) -> np.ndarray:
    """Rounded to a grid whose error has this standard deviation."""
    pixel = sigma * np.sqrt(12)
    return pixel * np.round(path / pixel)


def _all(path: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    found = in_pixels(remembering(path, sigma, rng), sigma)
    return gaps(swaps(false_finds(found, rng), rng), rng)


MEASURES: dict[str, Measure] = {
    "white": white,
    "ar1": remembering,
    "outliers": lambda path, sigma, rng: false_finds(white(path, sigma, rng), rng),
    "drop-outs": lambda path, sigma, rng: gaps(white(path, sigma, rng), rng),
    "swaps": lambda path, sigma, rng: swaps(white(path, sigma, rng), rng),
    "quantised": lambda path, sigma, rng: in_pixels(path, sigma),
    "all": _all,
}
STORMS = ("ar1", "outliers", "drop-outs", "swaps", "all")  # what the second bar is over
