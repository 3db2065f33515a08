"""Loops compiled ahead of the processes that need them."""

from __future__ import annotations

import torch

from dynamics.building import build
from dynamics.state import Parameters, PhaseState
from dynamics.terms import HEADS

ROLLED = ("factored", "factored-radial", "unstructured")  # between them, all loops that heads use
BODIES, EPISODES, DT = 3, 64, 0.01


def compile_ahead() -> None:
    """Compile what heads train and roll through in single precision.

    What is compiled is kept on disk: processes that start later load it, in place of each
    compiling the same for half a minute.
    """
    start = PhaseState(*torch.zeros(2, EPISODES, BODIES, 2))
    params = Parameters(torch.ones(EPISODES), torch.ones(EPISODES, BODIES))
    for name in ROLLED:
        head = build(HEADS[name], BODIES, DT)
        head.trajectory(start, params, 1, DT).states.flat.sum().backward()
        with torch.no_grad():
            head.trajectory(start, params, 1, DT)
