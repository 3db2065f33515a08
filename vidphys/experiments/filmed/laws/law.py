"""What a law of the filmed scenes is: a few numbers, and the exact path that follows from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81  # m/s^2
ACCURACY = 1e-9  # of an integration, relative and in metres or radians

Slope = Callable[[float, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Law:
    """A law with its start, in a plane whose second axis points up (or away, on a table).

    Args:
        names: of the numbers that :attr:`path` takes, the start's among them.
        path: ``(numbers (p,), times (t,)) -> (t, n, 2)``, metres and seconds; the times increase
            from 0 or later.
    """

    names: tuple[str, ...]
    path: Callable[[np.ndarray, np.ndarray], np.ndarray]


def integrate(slope: Slope, start: np.ndarray, times: np.ndarray) -> np.ndarray:
    """States ``(t, s)`` at increasing times (seconds), from a state ``(s,)`` at time 0.

    Raises:
        FloatingPointError: the integration failed.
    """
    span = (0.0, max(float(times[-1]), 1e-6))
    solved = solve_ivp(
        slope, span, start, "DOP853", dense_output=True, rtol=ACCURACY, atol=ACCURACY
    )
    if not solved.success:
        raise FloatingPointError(f"integrate: {solved.message}")
    return np.asarray(solved.sol(times)).T
