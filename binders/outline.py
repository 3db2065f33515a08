"""The outline of what goes along a way: what stays the same on it, and is not the background."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from binders.base import Pictures
from binders.hypotheses import Hypothesis
from binders.scenery import COLOURED, NOTICED

LOOKED_AT = 40  # frames
REACH = 0.22  # of the picture's shorter side, to each side of the way
CERTAIN = 4.0  # times as much as from itself a pixel differs from what is behind, to belong to it
NOISE = 9.0  # squared grey levels, that change by themselves
CLOSED = 5  # pixels of a gap in it
ARM = 0.5  # of its half width, that its arms are narrower than
SMALLEST = 1.5  # pixels of half its width
RIM = 3  # pixels around it, that it is compared with


def outlined(
    way: Float[np.ndarray, "t 2"],
    frames: Pictures,
    background: Float[np.ndarray, "h w 3"],
    changed: Pictures,
) -> Hypothesis | None:
    """What moves along a way as one, at the middle of its outline; ``None`` where nothing does.

    Args:
        way: of some of its points, pixels; NaN where they are not seen.
        frames: before a still camera.
        background: what stands still in them.
        changed: what differs from the background in more than brightness.
    """
    shape = _shape(way, frames, background)
    if shape is None:
        return None
    y, x = np.nonzero(shape)
    half = shape.shape[0] // 2
    middle = np.array([x.mean(), y.mean()]) - half
    area, width = float(len(x)), _half_width(shape)
    frame_count = len(way)
    columns = {name: np.full(frame_count, np.nan) for name in ("energy", "size", "radius", "lit")}
    columns["compact"] = np.full(frame_count, np.nan)
    colour = np.full((frame_count, 3), np.nan)
    seen = np.flatnonzero(np.isfinite(way[:, 0]))
    for t in seen:
        inside, beside, coloured = _sampled(frames[t], changed[t], shape, way[t])
        columns["energy"][t] = area * np.linalg.norm(inside - beside)
        columns["lit"][t] = 1 - min(1.0, COLOURED * coloured)
        colour[t] = inside
    columns["size"][seen] = np.sqrt(area / np.pi)
    columns["radius"][seen] = width
    columns["compact"][seen] = _compact(x, y)
    return Hypothesis(
        way + middle,
        columns["energy"],
        columns["size"],
        columns["radius"],
        _lab(colour),
        columns["compact"],
        columns["lit"],
        cornered=True,
    )


def _shape(way: np.ndarray, frames: Pictures, background: np.ndarray) -> np.ndarray | None:
    """The pixels that move along, in a square about the way, or ``None``."""
    import cv2

    half = round(REACH * min(background.shape[:2]))
    square = (2 * half + 1, 2 * half + 1)
    seen = np.flatnonzero(np.isfinite(way[:, 0]))
    some = seen[np.unique(np.linspace(0, len(seen) - 1, LOOKED_AT).astype(int))]

    def cut(image: np.ndarray, place: np.ndarray) -> np.ndarray:
        return cv2.getRectSubPix(image.astype(np.float32), square, place.tolist())

    shown = np.stack([cut(frames[t], way[t]) for t in some])
    behind = np.stack([cut(background, way[t]) for t in some])
    apart = ((shown - behind) ** 2).mean((0, -1))
    sure = (apart > CERTAIN * (shown.var(0).mean(-1) + NOISE)).astype(np.uint8)
    sure = cv2.morphologyEx(sure, cv2.MORPH_CLOSE, np.ones((CLOSED, CLOSED), np.uint8))
    edges, _ = cv2.findContours(sure, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(sure, edges, -1, 1, cv2.FILLED)
    return _stout(sure, half)


def _stout(mask: np.ndarray, half: int) -> np.ndarray | None:
    """Of what is about the middle of a mask the thick part."""
    import cv2

    count, labels = cv2.connectedComponents(mask, connectivity=4)
    if count == 1:
        return None
    y, x = np.nonzero(labels)
    nearest = np.argmin((x - half) ** 2 + (y - half) ** 2)
    region = (labels == labels[y[nearest], x[nearest]]).astype(np.uint8)
    deep = _depth(region)
    if deep.max() < SMALLEST:
        return None
    core = (deep > ARM * deep.max()).astype(np.uint8)
    away = cv2.distanceTransform(1 - core, cv2.DIST_L2, 5)
    return (region > 0) & (away <= ARM * deep.max())


def _depth(region: np.ndarray) -> np.ndarray:
    import cv2

    ground = cv2.copyMakeBorder(region, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    return cv2.distanceTransform(ground, cv2.DIST_L2, 5)[1:-1, 1:-1]


def _half_width(shape: np.ndarray) -> float:
    return float(_depth(shape.astype(np.uint8)).max())


def _compact(x: np.ndarray, y: np.ndarray) -> float:
    """As in :class:`binders.blobs.Blobs`."""
    spread = np.cov(np.stack([x, y])) + np.eye(2) / 12
    minor, major = 2 * np.sqrt(np.linalg.eigvalsh(spread))
    return float(min(1.0, len(x) / (np.pi * minor * major)) * min(1.0, 3 * minor / major))


def _sampled(
    frame: np.ndarray, changed: np.ndarray, shape: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean RGB of the shape in a frame and of what is next to it, and the share that changed."""
    import cv2

    half = shape.shape[0] // 2
    around = cv2.dilate(shape.astype(np.uint8), np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8))
    y, x = np.nonzero(around)
    corner = np.rint(place).astype(int) - half
    within = shape[y, x]
    x, y = x + corner[0], y + corner[1]
    high, wide = changed.shape
    there = (x >= 0) & (y >= 0) & (x < wide) & (y < high)
    pixels, within = frame[y[there], x[there]].astype(float), within[there]
    if not within.any() or within.all():
        return np.zeros(3), np.zeros(3), 0.0
    share = changed[y[there], x[there]].sum() / shape.sum()
    return pixels[within].mean(0), pixels[~within].mean(0), float(share)


def _lab(colour: np.ndarray) -> np.ndarray:
    import cv2

    shade = (colour / 255).astype(np.float32)[None]
    return (cv2.cvtColor(shade, cv2.COLOR_RGB2Lab)[0] / NOTICED).astype(float)
