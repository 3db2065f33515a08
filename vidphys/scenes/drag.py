"""Scenes with linear drag, dp/dt -= gamma p / m; gravity first."""

from __future__ import annotations

from dataclasses import replace

from torch import Generator

from dynamics import Hamiltonian, Parameters, PhaseState
from dynamics.friction import Friction
from vidphys.errors import InputError
from vidphys.scenes.draws import uniform
from vidphys.scenes.gravity import gravity
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
    return replace(dragged(gravity(), STRENGTHS[strength], spread), name=f"drag-{strength}")


def dragged(plain: Scene, usual: float = STRENGTHS["strong"], spread: float = 0.0) -> Scene:
    """A scene with linear drag on its bodies.

    Args:
        plain: the scene without.
        usual: gamma, kg per second; the episode's own stands in the scalar ``friction``.
        spread: half-width of its range, as a share of the usual value.

    Raises:
        InputError: a law that no friction can be added to, or that has some.

    Example:
        >>> from vidphys.scenes.springs import springs
        >>> scene = dragged(springs())
        >>> start, law = scene.sample(2, Generator().manual_seed(0))
        >>> scene.name, scene.conserves, law.scalar("friction").tolist()
        ('springs-dragged', False, [0.15, 0.15])
    """
    free = plain.law
    if not isinstance(free, Hamiltonian) or len(free.ports):
        raise InputError(f"dragged: {plain.name}: only a Hamiltonian without ports takes a drag")
    drag = Friction("linear", "known")
    law = Hamiltonian(free.kinetic, free.potential, free.integrator, ports=[drag])
    settings = {**plain.settings, "drag": usual, "spread": spread}
    sample = _dragged(plain.sample, usual, spread)
    return replace(plain, name=f"{plain.name}-dragged", law=law, sample=sample, settings=settings)


def _dragged(free: Sampler, usual: float, spread: float) -> Sampler:
    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        start, params = free(n, rng)
        around = (usual * (1 - spread), usual * (1 + spread))
        return start, params.with_scalar("friction", uniform((n,), around, rng))

    return sample
