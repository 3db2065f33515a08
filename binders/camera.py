"""The still part of a clip: its background, and the small drift of a hand-held camera.

A camera that "stands still" in a user's hand moves by several pixels. Each frame is registered to
the background by Gauss-Newton on the brightness (Lucas & Kanade 1981) with robust weights; only
pixels where the *background* has structure take part, so bodies that move do not pull.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from binders.reel import Through

ROUNDS = 4
STEPS = 15
STRUCTURE = 0.97
LEAST_SLOPE = 1.0  # brightness levels a pixel; what noise leaves in a median is below
PIXELS = (20, 6000)
REACH = 8.0
HIDDEN = 2.0  # times the usual scale of what is left, of a frame in which something hides much
SEED = 0


def camera_drift(grey: np.ndarray | Through, sample: list[int]) -> Float[np.ndarray, "t 2"]:
    """Translation of the still background in each frame, pixels (x right, y down).

    Args:
        grey: brightness of each frame ``(h, w)``, 0 to 255.
        sample: frames that the background is estimated from.

    Returns:
        ``(x, y)`` by which a still point is displaced, its median over ``sample`` being zero.
        Zero where the background has no structure to hold on to.
    """
    drift = np.zeros((len(sample), 2))
    background = grey[sample[0]]
    for _ in range(ROUNDS):
        aligned = [undo_drift(grey[i], d) for i, d in zip(sample, drift, strict=True)]
        background = np.median(aligned, axis=0)
        drift = _register(background, grey[sample], drift)
        drift -= np.median(drift, axis=0)
    guess = np.stack([np.interp(np.arange(len(grey)), sample, drift[:, i]) for i in (0, 1)], 1)
    return _register(background, grey, guess)


def undo_drift(
    image: Float[np.ndarray, "h w *c"], drift: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, "h w *c"]:
    """The image as a camera without drift would have seen it (linear interpolation)."""
    if not drift.any():
        return image
    for axis, shift in ((0, drift[1]), (1, drift[0])):
        whole = int(np.floor(shift))
        places = np.arange(image.shape[axis]) + whole
        here, next_to = (np.clip(places + k, 0, image.shape[axis] - 1) for k in (0, 1))
        part = np.asarray(shift - whole, image.dtype)
        image = image.take(here, axis) * (1 - part) + image.take(next_to, axis) * part
    return image


def background_of(
    images: Float[np.ndarray, "t h w *c"], hidden: Bool[np.ndarray, "t h w"] | None = None
) -> Float[np.ndarray, "h w *c"]:
    """Median over time of each pixel, over the frames in which no body hides it.

    A body that keeps coming back to one place is in the plain median there (a ghost); knowing
    roughly where it is in each frame removes it. A pixel that is always hidden keeps the plain
    median.
    """
    if hidden is None:
        return np.median(images, axis=0)
    always = hidden.all(0)
    masked = np.where((hidden & ~always)[..., None], np.nan, images)
    return np.nanmedian(masked, axis=0).astype(images.dtype)


def _register(
    background: np.ndarray, frames: np.ndarray | Through, guess: np.ndarray
) -> np.ndarray:
    smooth = ndimage.gaussian_filter(background, 1.0)
    slope_y, slope_x = np.gradient(smooth)
    ys, xs = _structure(np.hypot(slope_x, slope_y))
    if len(ys) == 0:
        return np.zeros_like(guess)
    gradient = np.stack([slope_x[ys, xs], slope_y[ys, xs]], 1)
    target = smooth[ys, xs]
    pixels = (ys, xs)

    def aligned(frame: np.ndarray, start: np.ndarray, most: float) -> tuple[np.ndarray, float]:
        return _align(ndimage.gaussian_filter(frame, 1.0), pixels, target, gradient, start, most)

    found = [aligned(*each, np.inf) for each in zip(frames, guess, strict=True)]
    drift, scale = np.array([x[0] for x in found]), np.array([x[1] for x in found])
    usual = float(np.median(scale))
    hidden = np.flatnonzero(scale > HIDDEN * usual)
    clear = np.flatnonzero(scale <= HIDDEN * usual)
    for number in hidden:
        start = np.array([np.interp(number, clear, drift[clear, axis]) for axis in (0, 1)])
        drift[number], _ = aligned(frames[number], start, usual)
    return drift


def _structure(slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels with the steepest background, away from the border; none where all is flat."""
    margin = int(min(REACH, min(slope.shape) / 4))
    inner = np.zeros(slope.shape, bool)
    inner[margin : slope.shape[0] - margin, margin : slope.shape[1] - margin] = True
    least = max(LEAST_SLOPE, float(np.quantile(slope[inner], STRUCTURE)))
    ys, xs = np.nonzero(inner & (slope >= least))
    fewest, most = PIXELS
    if len(ys) > most:
        keep = np.random.default_rng(SEED).choice(len(ys), most, replace=False)
        ys, xs = ys[keep], xs[keep]
    return (ys, xs) if len(ys) >= fewest else (ys[:0], xs[:0])


def _align(
    frame: np.ndarray,
    pixels: tuple[np.ndarray, np.ndarray],
    target: np.ndarray,
    gradient: np.ndarray,
    start: np.ndarray,
    most: float,
) -> tuple[np.ndarray, float]:
    """Gauss-Newton on the translation; a weak pull to zero decides where nothing else does.

    Args:
        most: of the scale beyond which what differs is something else.

    Returns:
        The translation, and the scale.
    """
    ys, xs = pixels
    drift, scale = start.astype(float), most
    for _ in range(STEPS):
        seen = ndimage.map_coordinates(frame, [ys + drift[1], xs + drift[0]], order=1)
        residual = seen - target
        residual = residual - np.median(residual)
        scale = min(most, 0.5 + 1.4826 * float(np.median(np.abs(residual))))
        weight = 1 / (1 + (residual / (2 * scale)) ** 2) ** 2
        pull = (scale / REACH) ** 2
        normal = gradient.T @ (weight[:, None] * gradient) + pull * np.eye(2)
        step = np.linalg.solve(normal, gradient.T @ (weight * residual) + pull * drift)
        drift = drift - step
        if np.abs(step).max() < 1e-3:
            break
    return drift, scale
