"""What drives a scene and is known: a motor's torque, a force, a current, recorded beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Signal:
    """Inputs as functions of time, straight between the times at which they were recorded.

    Args:
        names: of the inputs, as the table calls them.
        times: seconds, increasing, two or more, ``(t,)``.
        values: of each input, ``(t, m)``.
    """

    names: tuple[str, ...]
    times: np.ndarray
    values: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values ``(…, m)`` at times."""
        return np.stack([np.interp(times, self.times, x) for x in self.values.T], -1)

    def since(self, seconds: float) -> Signal:
        """The same, its times counted from a later moment."""
        return replace(self, times=self.times - seconds)
