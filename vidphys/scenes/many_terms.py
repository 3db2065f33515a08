"""Bodies under four forces at once: each other's pull, a uniform field, a trap, and drag."""

from __future__ import annotations

from dataclasses import replace

from dynamics import Hamiltonian
from dynamics.fields import UniformField
from dynamics.friction import Friction
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap, Potential, SoftenedGravity, SumPotential
from vidphys.scenes.gravity import SOFTENING, gravity
from vidphys.scenes.scene import Scene

ACCELERATION = (0.0, -2.0)  # world units per second squared
STIFFNESS = 1.5  # per second squared, of a unit mass
DRAG = 0.4  # kg per second


def many_terms(pair: Potential | None = None) -> Scene:
    """Gravity's starts and couplings under all four forces.

    Args:
        pair: how bodies pull each other; softened gravity where not given.

    Example:
        >>> scene = many_terms()
        >>> scene.conserves, sorted(scene.settings["terms"])
        (False, ['drag', 'field', 'pair', 'trap'])
    """
    plain = gravity()
    pair = SoftenedGravity(SOFTENING) if pair is None else pair
    field = UniformField(plain.space, ACCELERATION, learned=False)
    potential = SumPotential((pair, field, HarmonicTrap(STIFFNESS)))
    drag = Friction("linear", "positive", DRAG).requires_grad_(False)
    terms = {
        "pair": type(pair).__name__,
        "field": ACCELERATION,
        "trap": STIFFNESS,
        "drag": DRAG,
    }
    return replace(
        plain,
        name="many-terms",
        law=Hamiltonian(FixedKinetic(), potential, ports=[drag]),
        settings={**plain.settings, "terms": terms},
    )
