"""How far a recording reached, and whether a rollout goes beyond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.recordings.motion import Motion

BEYOND = 1.1  # times what was seen, from which on it is said


@dataclass(frozen=True)
class Seen:
    """Of a recording, in its own unit.

    Args:
        low, high: the least and the largest of each coordinate, ``d`` numbers.
        speed: the largest distance from a frame to the next of any body, per second.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    speed: float

    @classmethod
    def of(cls, motion: Motion) -> Seen:
        """All that a motion shows."""
        places = motion.positions
        low, high = np.nanmin(places, axis=(0, 1, 2)), np.nanmax(places, axis=(0, 1, 2))
        return cls(tuple(low.tolist()), tuple(high.tolist()), _fastest(places[0], motion.times[0]))

    def left(self, times: np.ndarray, positions: np.ndarray) -> str | None:
        """In words how a path leaves what was seen; ``None`` where it does not.

        Args:
            times: seconds ``(t,)``.
            positions: ``(t, n, d)``.
        """
        low, high = np.asarray(self.low), np.asarray(self.high)
        reach = np.abs(positions - (low + high) / 2).max((0, 1)) / ((high - low) / 2).max()
        said = []
        for axis, times_as_far in zip("xyz", reach, strict=False):
            if times_as_far > BEYOND:
                said.append(f"{times_as_far:.3g} times as far in {axis}")
        faster = _fastest(positions, times) / self.speed if self.speed > 0 else 1.0
        if faster > BEYOND:
            said.append(f"{faster:.3g} times as fast")
        return f"goes beyond what was recorded ({', '.join(said)})" if said else None


def _fastest(positions: np.ndarray, times: np.ndarray) -> float:
    away = np.linalg.norm(np.diff(positions, axis=0), axis=-1) / np.diff(times)[:, None]
    return float(np.nanmax(away)) if np.isfinite(away).any() else 0.0
