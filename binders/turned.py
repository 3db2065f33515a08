"""Whether a body turns in the picture, as a rolling ball or a spinning puck with a mark does.

One picture of all its frames is then that of no frame: its mark draws the place along.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

ANGLES = 72  # that are told apart in a whole turn
WITHIN = 0.85  # of a body's mean radius, that is looked at: not its edge, nor what is behind
ROUNDS = 3
EXPLAINED = 0.5  # of what one picture leaves, that the same picture leaves if it may turn
EVENLY = 1.5  # of these angles, by which what turns usually turns faster or slower
FAR = 15.0  # degrees, that it turns at least
SMOOTHED = 5  # frames, whose median is its angle


def turns(patches: Float[np.ndarray, "t s s c"], radius: float) -> bool:
    """Whether turning explains how a body's picture changes, and it turns steadily.

    Args:
        patches: pictures about its middle, in order.
        radius: of the body, pixels.

    Example:
        >>> y, x = np.mgrid[-10:11, -10:11]
        >>> mark = [np.hypot(x - 6 * np.cos(a), y - 6 * np.sin(a)) < 3 for a in np.linspace(0, 2)]
        >>> still = [mark[0]] * 50
        >>> [turns(200.0 * np.stack(each)[..., None], 10.0) for each in (mark, still)]
        [True, False]
    """
    rings = _unrolled(patches.astype(np.float32), radius)
    once = rings - np.median(rings, 0)
    angles, turned = _aligned(rings)
    left = turned - np.median(turned, 0)
    if (left**2).mean() >= EXPLAINED * (once**2).mean() or len(angles) < SMOOTHED + 2:
        return False
    path = np.unwrap(angles, period=ANGLES)
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(path, SMOOTHED), -1)
    evenly = np.median(np.abs(np.diff(path, 2))) <= EVENLY
    return bool(evenly and np.ptp(smooth) * 360 / ANGLES > FAR)


def _unrolled(patches: np.ndarray, radius: float) -> np.ndarray:
    """Rings about the middle as rows of angles, weighted as their areas are, ``(t, a, k)``."""
    import cv2

    middle, far = (patches.shape[1] - 1) / 2, max(3, round(WITHIN * radius))
    how = cv2.WARP_POLAR_LINEAR + cv2.INTER_LINEAR
    rings = np.stack(
        [cv2.warpPolar(each, (far, ANGLES), (middle, middle), far, how) for each in patches]
    ).reshape(len(patches), ANGLES, far, -1)
    weights = np.sqrt(np.arange(far) + 0.5)[:, None]
    return (rings * weights).reshape(len(patches), ANGLES, -1)


def _aligned(rings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By how many angles each is turned back to look as most do, and what is seen then."""
    spectra = np.fft.rfft(rings, axis=1)
    looks, angles, turned = spectra[0], np.zeros(len(rings), int), rings
    for _ in range(ROUNDS):
        alike = np.fft.irfft((spectra * looks.conj()).sum(-1), ANGLES, axis=1)
        angles = alike.argmax(1)
        turned = np.stack([np.roll(each, -k, 0) for each, k in zip(rings, angles, strict=True)])
        looks = np.fft.rfft(np.median(turned, 0), axis=0)
    return angles, turned
