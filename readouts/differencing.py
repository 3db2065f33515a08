"""Momentum from frame differences: the study's plain readout."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from dynamics import PhaseState


def central_difference(
    positions: Float[Tensor, "b t n d"], mass: Float[Tensor, "b n"], interval: float
) -> PhaseState:
    """States at the inner frames 1 .. t-2, momentum m (q[t+1] - q[t-1]) / (2 interval).

    Args:
        positions: world units, one frame each ``interval`` seconds.
        mass: of each body.
        interval: seconds between frames.

    Returns:
        States ``(b, t - 2, n, d)``; each momentum sits at its own frame.

    Raises:
        ValueError: fewer than three frames.

    Example:
        >>> import torch
        >>> times = 0.1 * torch.arange(5.0)
        >>> fall = (-0.5 * times**2).reshape(1, 5, 1, 1)  # metres, under 1 m/s^2
        >>> state = central_difference(fall, torch.ones(1, 1), interval=0.1)
        >>> [round(x, 3) for x in state.p.flatten().tolist()]  # at 0.1, 0.2, 0.3 s
        [-0.1, -0.2, -0.3]
    """
    _need(positions, 3, "central_difference")
    velocity = (positions[:, 2:] - positions[:, :-2]) / (2 * interval)
    return PhaseState(positions[:, 1:-1], mass[:, None, :, None] * velocity)


def backward_difference(
    positions: Float[Tensor, "b t n d"], mass: Float[Tensor, "b n"], interval: float
) -> PhaseState:
    """The state at the last frame from the last three, second order in the interval.

    v = (3 q[T] - 4 q[T-1] + q[T-2]) / (2 interval): nothing after the last frame is used.

    Returns:
        States ``(b, n, d)``.

    Raises:
        ValueError: fewer than three frames.

    Example:
        >>> import torch
        >>> times = 0.1 * torch.arange(5.0)
        >>> fall = (-0.5 * times**2).reshape(1, 5, 1, 1)
        >>> state = backward_difference(fall, torch.ones(1, 1), interval=0.1)
        >>> round(float(state.p), 3)  # at 0.4 s
        -0.4
    """
    _need(positions, 3, "backward_difference")
    a, b, c = positions[:, -1], positions[:, -2], positions[:, -3]
    velocity = (3 * a - 4 * b + c) / (2 * interval)
    return PhaseState(a, mass[..., None] * velocity)


def _need(positions: Tensor, frames: int, who: str) -> None:
    if positions.shape[1] < frames:
        raise ValueError(
            f"{who}: momentum needs at least {frames} frames, got {positions.shape[1]}; "
            "one frame shows places, not speeds"
        )
