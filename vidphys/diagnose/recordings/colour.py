"""The colour of the positions' noise: how long an error lasts, from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

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
