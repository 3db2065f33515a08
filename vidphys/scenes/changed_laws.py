"""Gravity's bodies under laws that a linear pair law is wrong about."""

from __future__ import annotations

from dataclasses import replace

from dynamics import Hamiltonian, PairLaw
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import Potential, SoftenedGravity, SumPotential
from dynamics.triples import PlummerTriple
from vidphys.scenes.gravity import SOFTENING, gravity
from vidphys.scenes.scene import Scene

TRIPLE_SOFTENING = 0.5  # world units
TRIPLE_STRENGTH = 6.0  # the flip then changes a 150-step rollout as much as in the study (1.23)


def gravity_of_power(coupling: str) -> Scene:
    """Softened gravity with V = c(G) sum m m phi.

    Args:
        coupling: of :data:`dynamics.powers.COUPLINGS`: ``linear`` is gravity itself; under
            ``even`` and ``quadratic`` a change of sign changes nothing.

    Raises:
        ValueError: unknown coupling.
    """
    scene = gravity()
    law = Hamiltonian(FixedKinetic(), SoftenedGravity(SOFTENING, PairLaw(coupling=coupling)))
    settings = {**scene.settings, "power": coupling}
    return replace(scene, name=f"gravity-{coupling}", law=law, settings=settings)


def three_body_gravity() -> Scene:
    """Softened gravity with a further force of each three bodies, which no sum over pairs is."""
    scene = gravity()
    parts: list[Potential] = [
        SoftenedGravity(SOFTENING),
        PlummerTriple(TRIPLE_SOFTENING, TRIPLE_STRENGTH),
    ]
    law = Hamiltonian(FixedKinetic(), SumPotential(parts))
    settings = {
        **scene.settings,
        "triple_softening": TRIPLE_SOFTENING,
        "triple_strength": TRIPLE_STRENGTH,
    }
    return replace(scene, name="gravity-three-body", law=law, settings=settings)
