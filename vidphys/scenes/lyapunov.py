"""Lyapunov time of a scene: how long a small error takes to grow by e."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dynamics import Parameters, PhaseState
from vidphys.scenes.scene import Scene

SEPARATION = 1e-7


def lyapunov_time(
    scene: Scene, start: PhaseState, params: Parameters, rounds: int = 100, steps: int = 100
) -> Float[Tensor, " b"]:
    """Per-episode Lyapunov time in seconds, by Benettin's two-trajectory method.

    A neighbour at distance 1e-7 is followed for ``steps`` reference steps, its growth is
    logged, it is pulled back, and so on for ``rounds`` rounds. The first quarter is not counted:
    there an offset grows linearly even where nothing is chaotic. The estimate is over a finite
    time (20 s by default); bodies that have flown apart lengthen it.

    Returns:
        ``(b,)``; infinity where the error did not grow.

    Example:
        >>> from vidphys.scenes.gravity import gravity
        >>> scene = gravity()
        >>> start, law = scene.sample(2, Generator().manual_seed(0))
        >>> seconds = lyapunov_time(scene, start, law, rounds=8, steps=20)
        >>> tuple(seconds.shape), bool((seconds > 0).all())
        ((2,), True)
    """
    x, size = start.flat.double(), SEPARATION
    # In no symmetric direction: a shift of all bodies alike is a motion of the centre, which never
    # grows, however chaotic the bodies are among themselves.
    offset = torch.randn(x.shape[-1], generator=Generator().manual_seed(0), dtype=x.dtype)
    offset = (offset * size / offset.norm()).expand_as(x)
    log_growth = torch.zeros(x.shape[0], dtype=torch.float64)
    settled = rounds // 4
    for index in range(rounds):
        ends = [
            scene.simulate(
                PhaseState.from_flat(y, scene.bodies, scene.space), params, steps, steps
            ).at(-1)
            for y in (x, x + offset)
        ]
        x, difference = ends[0].flat, ends[1].flat - ends[0].flat
        growth = difference.norm(dim=-1, keepdim=True) / size
        if index >= settled:
            log_growth += growth.squeeze(-1).log()
        offset = difference / growth
    rate = log_growth / ((rounds - settled) * steps * scene.dt)
    return torch.where(rate > 0, 1 / rate, torch.inf)
