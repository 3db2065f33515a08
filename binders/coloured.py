"""Blobs of one colour, that stand out of whatever they touch: a ball before a person who walks by.

Which colours bodies have is told by what is seen by itself at times; what else changes has colours
too, and a pixel belongs to the one that it is likest to.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float, Shaped

from binders.base import Pictures
from binders.blobs import Blobs
from binders.scenery import EDGE, NOTICED, lumps
from binders.wanted import HUE, LIKE

COLOURS = 8  # of bodies
OTHERS = 6  # of what else changes
ROUND = 0.9  # how compact a blob is that may be a body by itself
LARGEST = 0.15  # of the picture's shorter side, its radius
SPECK = 2.0  # pixels, a radius below which it is noise
LIT = 0.5  # of it that differs in brightness alone, beyond which it may be a shadow
ALIKE, ANOTHER = 0.6, 1.0  # in units of a difference that is noticed
FRAMES = 8  # that tell of all that changes
LOOKED_AT = 400  # blobs, or pixels of a frame, of which a colour is tried


def coloured_blobs(
    frames: Pictures,
    sample: Sequence[int],
    blobs: Sequence[Sequence[Blobs]],
    changed: Pictures,
    inside: Bool[np.ndarray, "h w"] | None,
    thin: int,
) -> list[list[Blobs]]:
    """For each colour that bodies may have, the blobs of each frame that have it.

    Args:
        frames: before a still camera.
        sample: frames that tell what colours else there are.
        blobs: of each frame, in each of the ways to find them.
        changed: what differs from the background in more than brightness.
        inside: where bodies are looked for; ``None`` where that is everywhere.
        thin: structures thinner than this many pixels belong to no body.
    """
    bodies = _of_bodies(blobs, LARGEST * min(frames.shape[1:3]))
    every = _of_all(frames, sample, changed)
    new = [each for each in every if (np.linalg.norm(bodies - each, axis=-1) > ANOTHER).all()]
    colours = np.array([*bodies, *new]).reshape(-1, 3)
    if not len(colours):
        return []
    found: list[list[Blobs]] = [[] for _ in colours]
    for image, mask in zip(frames, changed, strict=True):
        meant = mask if inside is None else mask & inside
        for kind, blob in zip(found, _divided(image, meant, colours, thin), strict=True):
            kind.append(blob)
    return found


def _of_bodies(blobs: Sequence[Sequence[Blobs]], largest: float) -> Float[np.ndarray, "k 3"]:
    """The colours of round blobs, the commonest and clearest first."""
    colours, weights = [np.zeros((0, 3))], [np.zeros(0)]
    for each in (each for kind in blobs for each in kind):
        lone = (each.compact > ROUND) & (each.lit < LIT)
        lone &= (each.size > SPECK) & (each.size < largest)
        colours.append(each.colour[lone] * HUE)
        weights.append(np.sqrt(each.energy[lone]) / each.size[lone])
    return _commonest(np.concatenate(colours), np.concatenate(weights), COLOURS)


def _of_all(frames: Pictures, sample: Sequence[int], changed: Pictures) -> Float[np.ndarray, "k 3"]:
    """The colours of all that changes in some frames."""
    pixels = []
    for frame in sample[:: max(1, len(sample) // FRAMES)]:
        shown = frames[frame][changed[frame]]
        pixels.append(_shades(shown[:: max(1, len(shown) // LOOKED_AT)]))
    every = np.concatenate(pixels)
    return _commonest(every, np.ones(len(every)), OTHERS)


def _commonest(
    colours: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"], most: int
) -> Float[np.ndarray, "k 3"]:
    """Middles of the heaviest clusters, none like another."""
    found: list[np.ndarray] = []
    while len(colours) and len(found) < most:
        tried = colours[:: max(1, len(colours) // LOOKED_AT)]
        near = np.linalg.norm(tried[:, None] - colours, axis=-1) < ALIKE
        middle = np.median(colours[near[(near * weights).sum(1).argmax()]], 0)
        found.append(middle)
        left = np.linalg.norm(colours - middle, axis=-1) > ANOTHER
        if left.all():
            break
        colours, weights = colours[left], weights[left]
    return np.array(found).reshape(-1, 3)


def _shades(pixels: Shaped[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Colours in units of a difference that is noticed; light counts less than hue."""
    import cv2

    if not len(pixels):
        return np.zeros((0, 3))
    lab = cv2.cvtColor(pixels[None].astype(np.float32) / 255, cv2.COLOR_RGB2Lab)[0]
    return lab / NOTICED * HUE


def _divided(
    image: np.ndarray, mask: np.ndarray, colours: np.ndarray, thin: int
) -> Iterator[Blobs]:
    """The blobs of a frame, of each colour."""
    y, x = np.nonzero(mask)
    apart = np.linalg.norm(_shades(image[y, x])[:, None] - colours, axis=-1)
    likest = np.where(apart.min(1) < LIKE / NOTICED, apart.argmin(1), -1)
    for colour in range(len(colours)):
        has = likest == colour
        yield _lumps_at(image, x[has], y[has], thin)


def _lumps_at(image: np.ndarray, x: np.ndarray, y: np.ndarray, thin: int) -> Blobs:
    """The lumps of some pixels, looked for no further than they reach."""
    height, width = image.shape[:2]
    around = thin + max(1, round(EDGE * min(height, width)))
    spots = np.array([[0, 0]]) if not len(x) else np.stack([x, y], 1)
    left, top = np.maximum(spots.min(0) - around, 0)
    right, bottom = spots.max(0) + around + 1
    part = image[top:bottom, left:right]
    has = np.zeros(part.shape[:2], np.float32)
    has[y - top, x - left] = 2.0
    found, _ = lumps(part, has, 1.0, thin, has > 0, None)
    return found.moved(int(left), int(top))
