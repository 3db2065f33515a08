"""The colour of the positions' noise: how long an error lasts, from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

ALIKE = 0.3  # share by which two memories may differ, and two shares of white noise


@dataclass(frozen=True)
class Colour:
    """Noise with a memory beside noise without, of one coordinate.

    Args:
        sigma: standard deviation of both together, world units.
        memory: seconds in which an error that lasts falls to 1 / e of itself.
        white: share of the variance that is without a memory.
    """

    sigma: float
    memory: float
    white: float = 0.0

    def near(self, other: Colour) -> bool:
        """Whether another colour is the same for all that a likelihood can tell."""
        memories = self.memory / other.memory
        return abs(self.white - other.white) <= ALIKE and 1 - ALIKE < memories < 1 / (1 - ALIKE)

    def covariance(self, times: np.ndarray) -> np.ndarray:
        """Covariance of unit variance at times ``(..., f)`` in seconds, ``(..., f, f)``."""
        apart = np.abs(times[..., :, None] - times[..., None, :])
        lasting = (1 - self.white) * np.exp(-apart / self.memory)
        return lasting + self.white * np.eye(times.shape[-1])

    def in_differences(self, order: int, interval: float) -> float:
        """Standard deviation of a difference of this order, over that of unit white noise.

        Args:
            order: how often neighbouring frames are subtracted.
            interval: seconds from frame to frame.
        """
        weights = np.array([(-1) ** k * comb(order, k) for k in range(order + 1)])
        covariance = self.covariance(interval * np.arange(order + 1))
        return float(np.sqrt(weights @ covariance @ weights / (weights @ weights)))
