"""One number over episodes, with what became of it: what a record holds."""

from __future__ import annotations

import math
from dataclasses import dataclass

OK, FAILED, INVALID, VOID = "ok", "failed", "invalid", "void"


@dataclass(frozen=True)
class Summary:
    """One number over a batch of episodes; ``value`` is None unless ``status`` is ok."""

    value: float | None
    status: str
    episodes: int
    nonfinite: int

    @classmethod
    def of(cls, value: float, episodes: int, nonfinite: int = 0) -> Summary:
        """A number, or a failure where it is none: NaN or infinite.

        Example:
            >>> Summary.of(float("inf"), episodes=4)
            Summary(value=None, status='failed', episodes=4, nonfinite=0)
        """
        if math.isfinite(value):
            return cls(float(value), OK, episodes, nonfinite)
        return cls(None, FAILED, episodes, nonfinite)
