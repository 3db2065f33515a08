"""States and clips that parts are asked about: few, ordinary, and the same each time."""

from __future__ import annotations

import torch
from torch import Tensor

from dynamics import Parameters, PhaseState

EPISODES = 4


def episodes(bodies: int, space: int) -> PhaseState:
    """States of unit size, bodies a unit or so apart, ``(4, n, d)``, float64."""
    rng = torch.Generator().manual_seed(0)
    shape = (EPISODES, bodies, space)
    q = 0.2 * torch.randn(shape, generator=rng, dtype=torch.float64)
    q[..., 0] += 1.2 * (torch.arange(bodies) - (bodies - 1) / 2)
    return PhaseState(q, 0.5 * torch.randn(shape, generator=rng, dtype=torch.float64))


def law(bodies: int, plain: bool = False) -> Parameters:
    """Couplings and masses between 0.5 and 1.5, ``(4,)`` and ``(4, n)``, float64.

    Unless ``plain``, charges of both signs, and all scalars that a term of ours asks for.
    """
    rng = torch.Generator().manual_seed(2)
    drawn = 0.5 + torch.rand(EPISODES, bodies + 1, generator=rng, dtype=torch.float64)
    coupling, mass = drawn[:, 0].clone(), drawn[:, 1:].clone()
    if plain:
        return Parameters(coupling, mass)
    charge = (1.0 - 2 * (torch.arange(bodies) % 2)).double().expand(EPISODES, bodies).clone()
    values = {"electric": 0.7, "friction": 0.8, "drive": 0.1, "temperature": 0.5}
    scalars = {name: torch.full_like(coupling, value) for name, value in values.items()}
    return Parameters(coupling, mass, charge, scalars)


def alike(params: Parameters) -> Parameters:
    """The same law for bodies of one mass and charge."""
    charge = None if params.charge is None else torch.ones_like(params.charge)
    return Parameters(params.coupling, torch.ones_like(params.mass), charge, params.scalars)


def moving_dots(clips: int, frames: int, side: int) -> tuple[Tensor, Tensor]:
    """Bytes ``(b, t, 3, side, side)`` of a bright square that moves, and seconds ``(t,)``."""
    pictures = torch.full((clips, frames, 3, side, side), 20, dtype=torch.uint8)
    for clip in range(clips):
        for frame in range(frames):
            row, column = (3 * clip + frame) % (side - 4), (5 * clip + 2 * frame) % (side - 4)
            pictures[clip, frame, :, row : row + 4, column : column + 4] = 230 - 30 * clip
    return pictures, torch.arange(frames, dtype=torch.float64) / 25
