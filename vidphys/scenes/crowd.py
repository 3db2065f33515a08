"""Softened gravity of many bodies, as dense as three are."""

from __future__ import annotations

import math
from dataclasses import replace

from torch import Generator

from dynamics import Parameters, PhaseState
from vidphys.scenes.gravity import gravity
from vidphys.scenes.scene import Scene

FEW = 3  # bodies in training


def crowd(bodies: int) -> Scene:
    """Gravity of N bodies whose places spread as sqrt(N / 3): the number density is that of three.

    The study does not say how its range grows with N. At a fixed range 32 bodies would meet far
    more closely than any training has shown.
    """
    plain = gravity(bodies=bodies)
    spread = math.sqrt(bodies / FEW)

    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        state, params = plain.sample(n, rng)
        return PhaseState(spread * state.q, state.p), params

    settings = {**plain.settings, "bodies": bodies, "spread": spread}
    return replace(
        plain,
        name=f"crowd-{bodies}",
        sample=sample,
        settings=settings,
        half_extent=spread * plain.half_extent,
    )
