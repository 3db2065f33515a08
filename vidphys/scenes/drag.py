"""Softened gravity with linear drag, dp/dt -= gamma p / m."""

from __future__ import annotations

from dataclasses import replace

from torch import Generator

from dynamics import Hamiltonian, Parameters, PhaseState
from dynamics.friction import Friction
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity
from vidphys.errors import InputError
from vidphys.scenes.draws import uniform
from vidphys.scenes.gravity import SOFTENING, gravity
from vidphys.scenes.scene import Sampler, Scene

STRENGTHS = {"weak": 0.05, "strong": 0.15}  # kg per second


def dragged_gravity(strength: str, spread: float = 0.0) -> Scene:
    """Gravity of three bodies, with drag.

    Args:
        strength: ``weak`` (0.05) or ``strong`` (0.15); the episode's own stands in the scalar
            ``friction``.
        spread: half-width of its range, as a share of the usual value.

    Raises:
        InputError: unknown strength.
    """
    if strength not in STRENGTHS:
        raise InputError(f"dragged_gravity: unknown strength '{strength}'; use weak or strong")
    usual, plain = STRENGTHS[strength], gravity()
    law = Hamiltonian(
        FixedKinetic(), SoftenedGravity(SOFTENING), ports=[Friction("linear", "known")]
    )
    settings = {**plain.settings, "drag": usual, "spread": spread}
    sample = _dragged(plain.sample, usual, spread)
    return replace(plain, name=f"drag-{strength}", law=law, sample=sample, settings=settings)


def _dragged(free: Sampler, usual: float, spread: float) -> Sampler:
    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        start, params = free(n, rng)
        around = (usual * (1 - spread), usual * (1 + spread))
        return start, params.with_scalar("friction", uniform((n,), around, rng))

    return sample
