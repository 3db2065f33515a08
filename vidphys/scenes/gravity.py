"""Softened gravity of N bodies in a plane, with two generators.

The study does not give its initial conditions. ``gaussian`` is our headline (it shows the
dissociation); ``ring`` is near-circular motion as in the HNN literature (it does not).
"""

from __future__ import annotations

import math

import torch
from torch import Generator

from dynamics import Hamiltonian, Parameters, PhaseState
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity
from vidphys.errors import InputError
from vidphys.scenes.draws import Range, at_rest, uniform
from vidphys.scenes.scene import Sampler, Scene

GENERATORS = ("gaussian", "ring")
SOFTENING = 0.1  # world units (the study)
DT = 0.002  # seconds (the study)
POSITION_STD, SPEED_STD = 1.0, 0.5
RING_RADII, RING_WOBBLE = (0.9, 1.2), 0.2


def gravity(
    generator: str = "gaussian",
    bodies: int = 3,
    mass: Range = (0.5, 1.5),
    coupling: Range = (0.5, 1.5),
) -> Scene:
    """Softened gravity.

    Args:
        generator: ``gaussian`` (q ~ N(0, 1), v ~ N(0, 0.5^2)) or ``ring`` (a ring of radius
            0.9 to 1.2 with circular speeds, each perturbed by 20 %).
        bodies: N.
        mass: masses are uniform in this range.
        coupling: G is uniform in this range; training data has G > 0 only.

    Raises:
        InputError: unknown generator.

    Example:
        >>> scene = gravity(bodies=3)
        >>> start, law = scene.sample(4, Generator().manual_seed(0))
        >>> truth = scene.simulate(start, law, steps=20)
        >>> tuple(truth.states.q.shape), scene.dt  # episodes, states, bodies, space; seconds
        ((4, 21, 3, 2), 0.002)
    """
    samplers = {"gaussian": _gaussian, "ring": _ring}
    if generator not in samplers:
        raise InputError(
            f"gravity: unknown generator '{generator}'; use one of {', '.join(samplers)}"
        )
    settings = {
        "generator": generator,
        "mass": mass,
        "coupling": coupling,
        "softening": SOFTENING,
        "dt_seconds": DT,
    }
    law = Hamiltonian(FixedKinetic(), SoftenedGravity(SOFTENING))
    sample = samplers[generator](bodies, mass, coupling)
    return Scene(f"gravity-{generator}", law, sample, bodies, DT, settings)


def _parameters(n: int, bodies: int, mass: Range, coupling: Range, rng: Generator) -> Parameters:
    return Parameters(coupling=uniform((n,), coupling, rng), mass=uniform((n, bodies), mass, rng))


def _gaussian(bodies: int, mass: Range, coupling: Range) -> Sampler:
    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        params = _parameters(n, bodies, mass, coupling, rng)
        q = POSITION_STD * torch.randn(n, bodies, 2, generator=rng, dtype=torch.float64)
        velocity = SPEED_STD * torch.randn(n, bodies, 2, generator=rng, dtype=torch.float64)
        return at_rest(q, velocity, params), params

    return sample


def _ring(bodies: int, mass: Range, coupling: Range) -> Sampler:
    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        params = _parameters(n, bodies, mass, coupling, rng)
        radius = uniform((n, 1, 1), RING_RADII, rng)
        phase = 2 * math.pi * torch.rand(n, 1, generator=rng, dtype=torch.float64)
        angle = phase + 2 * math.pi * torch.arange(bodies, dtype=torch.float64) / bodies
        q = radius * torch.stack([angle.cos(), angle.sin()], -1)
        inward = SoftenedGravity(SOFTENING).force(q, params) / params.mass.unsqueeze(-1)
        speed = (inward.norm(dim=-1, keepdim=True) * radius).sqrt()
        tangent = torch.stack([-angle.sin(), angle.cos()], -1)
        wobble = 1 + RING_WOBBLE * torch.randn(n, bodies, 2, generator=rng, dtype=torch.float64)
        return at_rest(q, speed * tangent * wobble, params), params

    return sample
