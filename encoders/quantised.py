"""Features in eight bits, with a scale and a mean for each channel of each feature frame.

Motion lies in small changes of a channel's mean over cells, below a step of its loudest cell. So
the mean is kept as it is, and the bits say by how much each cell differs from it. Steps are even,
from the least to the largest value (affine quantisation, as of Jacob et al., arXiv:1712.05877).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

EIGHT = "int8"
LEVELS = 127  # on either side of zero
CELLS = (-2, -1)  # axes


@dataclass(frozen=True)
class Quantised:
    """Feature maps in eight bits.

    Args:
        values: steps of each cell, int8 ``(..., c, h, w)``.
        scale: of a step, float32 ``(..., c)``; 0 where all cells are the same.
        mean: over the cells, float32 ``(..., c)``.
    """

    values: np.ndarray
    scale: np.ndarray
    mean: np.ndarray

    def numbers(self) -> np.ndarray:
        """What is read back, float32 ``(..., c, h, w)``."""
        found = self.values.astype(np.float32)
        found -= found.mean(CELLS, keepdims=True)
        found *= self.scale[..., None, None]
        found += self.mean[..., None, None]
        return found


def quantised(maps: np.ndarray) -> Quantised:
    """Finite maps ``(..., c, h, w)``, each value within a step of what is read back.

    Mostly it is half a step; the other half is what the mean, which stays exact, may shift them by.

    Example:
        >>> maps = np.array([[[227.0, 131.6], [40.4, 1.0]]], np.float32)  # of mean 100
        >>> kept = quantised(maps)
        >>> kept.values.tolist(), kept.mean.tolist()
        ([[[127, 20], [-83, -127]]], [100.0])
        >>> [round(x, 1) for x in kept.numbers().flatten().tolist()]
        [227.0, 131.8, 40.2, 1.0]
    """
    whole = np.asarray(maps, np.float32)
    low, high = (end(CELLS).astype(np.float64) for end in (whole.min, whole.max))
    scale = ((high - low) / (2 * LEVELS)).astype(np.float32)
    middle = ((high + low) / 2).astype(np.float32)
    steps = whole - middle[..., None, None]
    steps /= np.where(scale > 0, scale, 1)[..., None, None]
    values = np.rint(steps, out=steps).clip(-LEVELS, LEVELS).astype(np.int8)
    return Quantised(values, scale, whole.mean(CELLS, dtype=np.float64).astype(np.float32))
