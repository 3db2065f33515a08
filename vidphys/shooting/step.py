"""A head in steps of a clip: its model step, and the states at the frames that follow."""

from __future__ import annotations

from dynamics import Head, Parameters, PhaseState

HEAD_DT = 0.01  # seconds; model step of every head that is trained on perceived tracks


def model_step(interval: float) -> tuple[float, int]:
    """The model step nearest to ``HEAD_DT`` that divides a frame interval (seconds).

    Returns:
        The step in seconds and the number of steps a frame.

    Example:
        >>> model_step(0.04)  # frames at 25 per second: four steps of 0.01 s
        (0.01, 4)
    """
    every = max(1, round(interval / HEAD_DT))
    return interval / every, every


def roll(
    head: Head, start: PhaseState, params: Parameters, stored: int, dt: float, every: int
) -> PhaseState:
    """``stored`` later states, ``every`` steps apart, ``(..., stored, n, d)``; differentiable."""
    states = head.trajectory(start, params, stored * every, dt, every).states
    return states.map(lambda x: x[..., 1:, :, :])
