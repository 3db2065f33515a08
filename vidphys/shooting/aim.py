"""Two frames and a law: the state that the law carries from the one to the other."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from binders.tracker import Motion, extrapolate
from dynamics import Head, Parameters, PhaseState
from vidphys.placement import device_of, moved
from vidphys.shooting.step import HEAD_DT, roll

ROUNDS = 3
PRECISE = 0.01  # world units


def aim(
    head: Head,
    here: Float[Tensor, "*b n d"],
    there: Float[Tensor, "*b n d"],
    params: Parameters,
    dt: float,
    every: int,
) -> PhaseState:
    """The state at ``here`` from which the head reaches ``there`` one frame later.

    Momentum starts as that of a straight line; each round rolls one frame and makes up for the
    miss as if no force depended on it. Unlike a difference of frames it has no truncation error
    but the head's own. No gradient flows through the corrections.

    Args:
        head: the law.
        here, there: positions in neighbouring frames, ``(..., n, d)``.
        params: the law's parameters, ``(...)`` and ``(..., n)``.
        dt: seconds of a model step.
        every: model steps between frames.

    Example:
        >>> from dynamics import ballistic
        >>> here, there = torch.zeros(1, 1, 2), torch.ones(1, 1, 2)
        >>> law = Parameters(torch.ones(1), torch.full((1, 1), 2.0))
        >>> aim(ballistic(), here, there, law, dt=0.01, every=10).p.round(decimals=3).tolist()
        [[[20.0, 20.0]]]
    """
    per_velocity = params.mass.unsqueeze(-1) / (every * dt)
    start = PhaseState(here, per_velocity * (there - here))
    for _ in range(ROUNDS):
        with torch.no_grad():
            miss = there - roll(head, start, params, 1, dt, every).q[..., 0, :, :]
        start = PhaseState(here, start.p + per_velocity * miss)
    return start


def surprise(
    head: Head,
    positions: Float[Tensor, "*b frames n d"],
    params: Parameters,
    dt: float,
    every: int,
    precise: float = PRECISE,
) -> Float[Tensor, "*b later n"]:
    """Robust error of the head's predictions from windows' first two frames.

    The head is aimed from the first frame at the second and compared with those after. A
    difference of frames would be wrong most of all at encounters, which are shorter than a frame
    interval.

    Args:
        head: predicts.
        positions: ``(..., frames, n, d)``, at least three frames.
        params: ``(...)`` and ``(..., n)``.
        dt: seconds of a model step.
        every: model steps between frames.
        precise: errors below it count by their square, above by their logarithm.

    Returns:
        log(1 + e^2 / precise^2) of each frame after the second, ``(..., frames - 2, n)``: one
        lost body does not outweigh the others' precision.
    """
    first, second = positions[..., 0, :, :], positions[..., 1, :, :]
    start = aim(head, first, second, params, dt, every)
    seen = roll(head, start, params, positions.shape[-3] - 1, dt, every).q[..., 1:, :, :]
    error = (seen - positions[..., 2:, :, :]).square().sum(-1)
    return (error / precise**2).log1p()


def motion_under(head: Head, params: Parameters, every: int) -> Motion:
    """Where the head takes bodies next, for a tracker: the last two frames, carried on.

    Two frames fix the state, so that an encounter is followed where extrapolation overshoots.
    Where the head's answer is not finite, the frames are extrapolated.

    Args:
        head: the law.
        params: of each clip, ``(b,)`` and ``(b, n)``.
        every: model steps between frames.
    """
    law_of_clips = moved(params, device_of(head))

    def motion(past: Tensor) -> Tensor:
        plain = extrapolate(past)
        if past.shape[-3] < 2:
            return plain
        law = law_of_clips.map(lambda x: x.unsqueeze(1).expand(-1, past.shape[1], *x.shape[1:]))
        here, there = past[..., -2, :, :], past[..., -1, :, :]
        start = aim(head, here, there, law, HEAD_DT, every)
        with torch.no_grad():
            seen = roll(head, start, law, 2, HEAD_DT, every).q[..., 1, :, :]
        return torch.where(torch.isfinite(seen).all(-1, keepdim=True), seen, plain)

    return motion
