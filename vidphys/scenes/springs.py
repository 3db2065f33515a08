"""Bodies joined by springs that break beyond a cutoff, and mend within it."""

from __future__ import annotations

from torch import Generator

from dynamics import Hamiltonian, PairLaw, Parameters, PhaseState
from dynamics.contact import CutSpring
from dynamics.kinetic import FixedKinetic
from vidphys.scenes.draws import Range, at_rest, normal, uniform
from vidphys.scenes.scene import Scene

CUTOFF = 1.0  # world units
STIFFNESS: Range = (2.5, 7.5)  # about 5
MASS: Range = (0.5, 1.5)
DT = 0.002  # seconds
POSITION_STD, SPEED_STD = 0.7, 0.5


def springs(stiffness: Range = STIFFNESS, bodies: int = 3) -> Scene:
    """H = K + coupling sum_{i<j} (min(r, 1)^2 - 1) / 2: an attraction of finite range.

    The coupling is the stiffness, positive in training; a flipped one pushes bodies apart until
    the cutoff. The force ends with a jump there, at which a step of leapfrog loses or gains up
    to ``stiffness * cutoff * speed * dt`` of energy.

    Args:
        stiffness: uniform in this range; one value where its ends are equal.
        bodies: N.

    Example:
        >>> scene = springs(stiffness=(5.0, 5.0))
        >>> start, law = scene.sample(2, Generator().manual_seed(0))
        >>> scene.bodies, law.coupling.tolist()
        (3, [5.0, 5.0])
    """

    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        params = Parameters(uniform((n,), stiffness, rng), uniform((n, bodies), MASS, rng))
        shape = (n, bodies, 2)
        q, v = normal(shape, POSITION_STD, rng), normal(shape, SPEED_STD, rng)
        return at_rest(q, v, params), params

    settings = {
        "coupling": stiffness,
        "mass": MASS,
        "cutoff": CUTOFF,
        "position_std": POSITION_STD,
        "speed_std": SPEED_STD,
        "dt_seconds": DT,
    }
    law = Hamiltonian(FixedKinetic(), CutSpring(CUTOFF, PairLaw("alike")))
    return Scene("springs", law, sample, bodies, DT, settings)
