"""How far a recording reached, and whether a rollout goes beyond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MOST = 0.99
BEYOND = 1.1  # times what was seen, from which on it is said


@dataclass(frozen=True)
class Seen:
    """Of a recording, in its own unit.

    Args:
        low, high: the least and the largest of each coordinate, ``d`` numbers.
        speed: the largest of any body, but for a hundredth of the frames.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    speed: float

    @classmethod
    def of(cls, times: np.ndarray, positions: np.ndarray) -> Seen:
        """All that a recording shows, at times ``(t,)`` and places ``(t, n, d)``, NaN for none."""
        low, high = np.nanmin(positions, axis=(0, 1)), np.nanmax(positions, axis=(0, 1))
        return cls(tuple(low.tolist()), tuple(high.tolist()), _fastest(positions, times))

    def reach(self, positions: np.ndarray) -> np.ndarray:
        """How many times as far from the middle as what was seen, ``(..., d)`` as the positions."""
        low, high = np.asarray(self.low), np.asarray(self.high)
        middle, half = (low + high) / 2, (high - low) / 2
        # along an axis on which nothing moved, a hundredth of the others' way is no leaving
        half = np.maximum(half, max(0.01 * half.max(), np.finfo(float).tiny))
        return np.abs(positions - middle) / half

    def left(self, times: np.ndarray, positions: np.ndarray) -> str | None:
        """In words how a path leaves what was seen; ``None`` where it does not.

        Args:
            times: seconds ``(t,)``.
            positions: ``(t, n, d)``.
        """
        said = []
        for axis, times_as_far in zip("xyz", self.reach(positions).max((0, 1)), strict=False):
            if times_as_far > BEYOND:
                said.append(f"{times_as_far:.3g} times as far in {axis}")
        faster = _fastest(positions, times) / self.speed if self.speed > 0 else 1.0
        if faster > BEYOND:
            said.append(f"{faster:.3g} times as fast")
        return f"goes beyond what was recorded ({', '.join(said)})" if said else None


def _fastest(positions: np.ndarray, times: np.ndarray) -> float:
    """The speed that one in a hundred is above: a single frame may be wrong."""
    away = np.linalg.norm(np.diff(positions, axis=0), axis=-1) / np.diff(times)[:, None]
    return float(np.nanquantile(away, MOST)) if np.isfinite(away).any() else 0.0
