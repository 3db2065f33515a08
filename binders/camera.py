"""The still part of a clip: its background, and the small drift of a hand-held camera.

A camera that "stands still" in a user's hand moves by several pixels, and rolls about its axis.
Each frame is registered to the background by Gauss-Newton on the brightness (Lucas & Kanade 1981)
with robust weights; only pixels where the *background* has structure take part, so bodies that move
do not pull, nor does what is drawn on all frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from binders.drawn import LEAST_SLOPE, drawn_on
from binders.reel import Through

ROUNDS = 4
STEPS = 15
STRUCTURE = 0.97
PIXELS = (20, 6000)
REACH = 8.0
ROLLS = 0.5  # pixels at the corners, root mean square, from which a camera rolls
HIDDEN = 2.0  # times the usual scale of what is left, of a frame in which something hides much
LED_ASTRAY = 3.0  # pixels, from which a drift may be that of somebody who hides what stands
AGREE = 5.0  # levels, by which brightness may differ where the background is
AS_ONE = 0.6  # agreement, from which edges move as one
STANDS = 0.7  # share of the frames, that show what stands and is not hidden often
SEED = 0


def camera_drift(grey: np.ndarray | Through, sample: list[int]) -> Float[np.ndarray, "t 3"]:
    """How the still background is displaced in each frame, and turned about the picture's middle.

    Args:
        grey: brightness of each frame ``(h, w)``, 0 to 255.
        sample: frames that the background is estimated from.

    Returns:
        ``(x, y)`` by which the picture's middle is displaced, pixels (x right, y down), and the
        angle by which the background is turned from x to y, radians; their medians over ``sample``
        are zero. Angles are zero of a camera that hardly rolls, and all are where the background
        has no structure to hold on to.
    """
    some = grey[sample]
    best, drawn = _likeliest(some)
    guess = [np.interp(np.arange(len(grey)), sample, column) for column in best.drift.T]
    found, _ = _register(best.background, grey, np.stack(guess, 1), drawn)
    return np.pad(found, ((0, 0), (0, 3 - found.shape[1])))


def _likeliest(grey: np.ndarray) -> tuple[_Registered, np.ndarray]:
    """How a few frames lie on their background, and the pixels that were left out for it.

    What stands while other edges move is drawn on all frames that a moving camera took. If the
    other edges do not move as one, the camera stands, and somebody large is before it: they are
    left out, or else what they seem to leave of the background.
    """
    drawn = drawn_on(grey)
    found = _laid(grey, drawn)
    if found.agreed >= AS_ONE:
        return found, drawn
    others = drawn | _often_hidden(grey), np.zeros_like(drawn)
    ways = [(found, drawn), *((_laid(grey, each), each) for each in others)]
    return max(ways, key=lambda each: each[0].agreed)


def _often_hidden(grey: np.ndarray) -> np.ndarray:
    """Pixels that show something else in many frames, if the camera stands."""
    seen = np.abs(grey - np.median(grey, axis=0)) < AGREE
    return np.asarray(seen.mean(0) < STANDS)


class _Registered(NamedTuple):
    """The background of a few frames, their drift from it, and how well they agree with it."""

    background: np.ndarray
    drift: np.ndarray
    agreed: float


def _laid(grey: np.ndarray, drawn: np.ndarray) -> _Registered:
    """A few frames on their background, turned as well where the camera rolls."""
    flat = _registered(grey, np.zeros((len(grey), 2)), drawn)
    rolled, _ = _register(flat.background, grey, np.pad(flat.drift, ((0, 0), (0, 1))), drawn)
    if np.sqrt(np.mean(rolled[:, 2] ** 2)) * _arm(flat.background) <= ROLLS:
        return flat
    return max(flat, _registered(grey, rolled, drawn), key=lambda each: each.agreed)


def _registered(grey: np.ndarray, drift: np.ndarray, drawn: np.ndarray) -> _Registered:
    found = []
    for _ in range(ROUNDS):
        aligned = [undo_drift(each, d) for each, d in zip(grey, drift, strict=True)]
        background = np.median(aligned, axis=0)
        drift, agreed = _register(background, grey, drift, drawn)
        drift -= np.median(drift, axis=0)
        found.append(_Registered(background, drift, agreed))
    return max(found, key=lambda each: each.agreed)


def _arm(image: np.ndarray) -> float:
    """From the picture's middle to its corners, pixels."""
    return float(np.hypot(*image.shape[:2]) / 2)


def turned_by(drift: Float[np.ndarray, "t 3"], size: tuple[int, int]) -> Float[np.ndarray, "t 3 3"]:
    """A drift as homographies, from the still background to each frame.

    Args:
        drift: as :func:`camera_drift` gives it; the angles are small.
        size: (height, width), pixels.
    """
    (x, y, roll), (cy, cx) = drift.T, ((n - 1) / 2 for n in size)
    turns = np.tile(np.eye(3), (len(drift), 1, 1))
    turns[:, 0, 1], turns[:, 1, 0] = -roll, roll
    turns[:, 0, 2], turns[:, 1, 2] = x + roll * cy, y - roll * cx
    return turns


def undo_drift(
    image: Float[np.ndarray, "h w *c"], drift: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "h w *c"]:
    """The image as a camera without drift would have seen it (linear interpolation).

    Args:
        image: of any number of channels.
        drift: of :func:`camera_drift`, with or without the angle.
    """
    import cv2

    if drift[2:].any():
        turn = turned_by(drift[None], (image.shape[0], image.shape[1]))[0, :2]
        back = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        edge = cv2.BORDER_REPLICATE
        return cv2.warpAffine(image, turn, image.shape[1::-1], flags=back, borderMode=edge)
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
    background = np.median(images, axis=0)
    if hidden is not None:
        few = hidden.any(0) & ~hidden.all(0)  # of the pixels: a median without some frames is slow
        seen = np.where(hidden[:, few, None], np.nan, images[:, few])
        background[few] = np.nanmedian(seen, axis=0)
    return background


def _register(
    background: np.ndarray, frames: np.ndarray | Through, guess: np.ndarray, drawn: np.ndarray
) -> tuple[np.ndarray, float]:
    smooth = ndimage.gaussian_filter(background, 1.0)
    slope_y, slope_x = np.gradient(smooth)
    ys, xs = _structure(np.where(drawn, 0.0, np.hypot(slope_x, slope_y)))
    if len(ys) == 0:
        return np.zeros_like(guess), 0.0
    from_middle = [(at - (n - 1) / 2) for at, n in zip((ys, xs), smooth.shape, strict=True)]
    across, down = slope_x[ys, xs], slope_y[ys, xs]
    turned = (down * from_middle[1] - across * from_middle[0]) / _arm(smooth)
    gradient = np.stack([across, down, turned], 1)[:, : guess.shape[1]]
    target = smooth[ys, xs]
    arms = np.array(from_middle) / _arm(smooth)
    unit = np.array([1.0, 1.0, _arm(smooth)])[: guess.shape[1]]

    def aligned(frame: np.ndarray, start: np.ndarray, most: float) -> _Aligned:
        smooth = ndimage.gaussian_filter(frame, 1.0)
        still = np.zeros(len(unit))
        found = _align(smooth, (ys, xs), arms, target, gradient, start * unit, most)
        if np.abs(found.drift).max() > LED_ASTRAY:
            again = _align(smooth, (ys, xs), arms, target, gradient, still, most)
            found = max(found, again, key=lambda each: each.agreed)
        return replace(found, drift=found.drift / unit)

    found = [aligned(*each, np.inf) for each in zip(frames, guess, strict=True)]
    drift, scale = np.array([x.drift for x in found]), np.array([x.scale for x in found])
    usual = float(np.median(scale))
    hidden = np.flatnonzero(scale > HIDDEN * usual)
    clear = np.flatnonzero(scale <= HIDDEN * usual)
    for number in hidden:
        start = np.array([np.interp(number, clear, column) for column in drift[clear].T])
        found[number] = aligned(frames[number], start, usual)
    return np.array([x.drift for x in found]), float(np.mean([x.agreed for x in found]))


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


@dataclass(frozen=True)
class _Aligned:
    """The drift as it was sought, the scale of what is left, and the share that agrees with it."""

    drift: np.ndarray
    scale: float
    agreed: float


def _align(
    frame: np.ndarray,
    pixels: tuple[np.ndarray, np.ndarray],
    arms: np.ndarray,
    target: np.ndarray,
    gradient: np.ndarray,
    start: np.ndarray,
    most: float,
) -> _Aligned:
    """Gauss-Newton on the drift; a weak pull to zero decides where nothing else does.

    Args:
        arms: of the pixels ``(2, n)``, rows and columns from the middle over its distance from the
            corners.
        start: displacement, and what the turn displaces the corners by where it is sought, pixels.
        most: of the scale beyond which what differs is something else.
    """
    ys, xs = pixels
    drift, scale = start.astype(float), most
    turn = np.array([1.0, -1.0])[:, None] * arms[::-1] if len(drift) > 2 else 0.0 * arms

    def left(drift: np.ndarray) -> np.ndarray:
        down, right = drift[1::-1, None] + turn * drift[-1]
        seen = ndimage.map_coordinates(frame, [ys + down, xs + right], order=1) - target
        return np.asarray(seen - np.median(seen))

    for _ in range(STEPS):
        residual = left(drift)
        scale = min(most, 0.5 + 1.4826 * float(np.median(np.abs(residual))))
        weight = 1 / (1 + (residual / (2 * scale)) ** 2) ** 2
        pull = (scale / REACH) ** 2
        normal = gradient.T @ (weight[:, None] * gradient) + pull * np.eye(len(drift))
        step = np.linalg.solve(normal, gradient.T @ (weight * residual) + pull * drift)
        drift = drift - step
        if np.abs(step).max() < 1e-3:
            break
    return _Aligned(drift, scale, float(np.mean(1 / (1 + (left(drift) / AGREE) ** 2))))
