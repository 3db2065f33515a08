"""Frames as one exposure would have shown them: phones brighten and darken as they film."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from binders.reel import Reel, filled

KNOWN = 30.0, 225.0  # levels between which a pixel tells of the exposure: neither black nor blown
EVERY = 4  # pixels, of which one is looked at
MOST, AGREES = 1.5, 0.1  # logarithms of it that are looked for, and within which pixels agree
DRIFTS = 1.04  # times the least exposure, from which the most is another


def evenly_lit(still: Reel, sample: list[int]) -> Reel:
    """The frames times what makes most of their background as bright as usual, in each channel.

    They are left as they are where that hardly differs from frame to frame.

    Args:
        still: RGB bytes ``(t, h, w, 3)``, before a background that stands.
        sample: frames that the background is known by.
    """
    usual = np.median(still[sample][:, ::EVERY, ::EVERY], 0).astype(np.float32)
    light = np.stack([_exposure(frame[::EVERY, ::EVERY], usual) for frame in still])
    if (np.ptp(np.log(light), axis=0) < np.log(DRIFTS)).all():
        return still
    return filled(
        np.clip(np.rint(frame / each), 0, 255).astype(np.uint8)
        for frame, each in zip(still, light, strict=True)
    )


def _exposure(frame: np.ndarray, usual: np.ndarray) -> Float[np.ndarray, " 3"]:
    """Of each channel, times the usual one, as most pixels agree on; 1 where none tells of it."""
    out = np.ones(3, np.float32)
    for channel in range(3):
        shown, known = frame[..., channel], usual[..., channel]
        tells = (known > KNOWN[0]) & (known < KNOWN[1]) & (shown > 0)
        if tells.any():
            light = np.log(shown[tells] / known[tells])
            count, edges = np.histogram(light, np.arange(-MOST, MOST, AGREES))
            near = np.abs(light - edges[count.argmax()] - AGREES / 2) < AGREES
            out[channel] = np.exp(np.median(light[near])) if near.any() else 1.0
    return out
