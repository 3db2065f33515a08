"""A rival's way to the trick of compiled rollouts: the trained pair law as a spline, in JAX."""

from __future__ import annotations

import copy

import jax.numpy as jnp
import numpy as np
import torch
from scipy.interpolate import CubicSpline

from benchmarks.peers import Array, Pair, Weights, soft
from dynamics.compiled.build import Sample
from dynamics.potentials import CORE, RadialPotential


def splined(potential: RadialPotential, reach: float, knots: int) -> Pair:
    """A rival's way to the same trick: the radial law as a cubic spline of log r, in JAX.

    Args:
        potential: trained.
        reach: world units; beyond it the outermost piece is used.
        knots: evenly spread in the logarithm of the softened distance.
    """
    far = np.log(np.hypot(reach, CORE))
    x = np.linspace(np.log(CORE), far, knots)
    exact = copy.deepcopy(potential).double()
    with torch.no_grad():
        energy = exact.distance_energy(torch.from_numpy(np.exp(x))[:, None]).numpy()
    pieces = jnp.asarray(CubicSpline(x, energy).c.astype(np.float32))  # (4, knots - 1)
    start, step = float(x[0]), float(x[1] - x[0])

    def gradient(_: Weights, displacement: Array) -> Array:
        r = soft(displacement)
        place = (jnp.log(r) - start) / step
        piece = jnp.clip(place.astype(jnp.int32), 0, knots - 2)
        along = (place - piece) * step
        cubic, square, slope, _height = pieces[:, piece]
        return ((3 * cubic * along + 2 * square) * along + slope) * displacement / r**2

    return gradient


def force_error(potential: RadialPotential, gradient: Pair) -> float:
    """Largest error of a radial force over the largest force within a third of the distance."""
    sample = Sample.of(copy.deepcopy(potential).double(), 100.0)
    found = np.asarray(gradient([], jnp.asarray(sample.places.float().numpy())), np.float64)
    wrong = np.linalg.norm(found - sample.forces.numpy(), axis=-1).max(-1)
    return float((wrong / sample.size.numpy()).max())
