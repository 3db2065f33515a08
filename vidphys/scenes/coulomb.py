"""Charges under softened Coulomb forces, and under gravity at the same time."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Generator, Tensor

from dynamics import Hamiltonian, PairLaw, Parameters, PhaseState
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import PairPotential, SoftenedGravity, SumPotential
from vidphys.scenes.draws import Range, at_rest, normal, uniform
from vidphys.scenes.scene import Scene

SOFTENING = 0.1  # world units, as in gravity
DT = 0.002  # seconds
STRENGTH: Range = (0.5, 1.5)
MASS: Range = (0.5, 1.5)
POSITION_STD, SPEED_STD = 1.0, 0.5


def coulomb(bodies: int = 3) -> Scene:
    """Unit masses with charges of +1 and -1, never all of one sign.

    H = K + electric sum_{i<j} z_i z_j / sqrt(r^2 + softening^2). What is held out is the
    all-repulsive set of charges, see :func:`all_alike`. There is no other force: G is 1 in every
    episode and stands in no term.

    Example:
        >>> start, law = coulomb(bodies=3).sample(8, Generator().manual_seed(0))
        >>> sorted(set(law.charge.flatten().tolist())), law.scalar('electric').shape
        ([-1.0, 1.0], torch.Size([8]))
    """

    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        one = torch.ones(n, dtype=torch.float64)
        charge = mixed_signs(n, bodies, rng)
        electric = {"electric": uniform((n,), STRENGTH, rng)}
        params = Parameters(one, one.unsqueeze(-1).expand(n, bodies).clone(), charge, electric)
        return _start(params, rng), params

    law = Hamiltonian(FixedKinetic(), _softened("charge"))
    settings = {**_SETTINGS, "mass": 1.0, "charges": "+1 and -1, not all alike"}
    return Scene("coulomb", law, sample, bodies, DT, settings)


def gravity_and_coulomb(bodies: int = 3) -> Scene:
    """Masses and charges at once, each law with its own strength.

    Charges are +1 or -1 in any combination; G and the electric strength are both positive in
    training, and either may be flipped.
    """

    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        params = Parameters(
            uniform((n,), STRENGTH, rng),
            uniform((n, bodies), MASS, rng),
            _signs((n, bodies), rng),
            {"electric": uniform((n,), STRENGTH, rng)},
        )
        return _start(params, rng), params

    law = Hamiltonian(
        FixedKinetic(), SumPotential([_softened(source) for source in ("mass", "charge")])
    )
    settings = {**_SETTINGS, "coupling": STRENGTH, "mass": MASS, "charges": "+1 and -1"}
    return Scene("gravity-and-coulomb", law, sample, bodies, DT, settings)


_SETTINGS = {
    "electric": STRENGTH,
    "softening": SOFTENING,
    "position_std": POSITION_STD,
    "speed_std": SPEED_STD,
    "dt_seconds": DT,
}


def mixed_signs(n: int, bodies: int, rng: Generator) -> Tensor:
    """Charges of +1 and -1, ``(n, bodies)``, with at least one of each sign in every episode."""
    charge = _signs((n, bodies), rng)
    # All alike: turn one body over; which one is as random as the rest.
    alike = charge.sum(-1).abs() == bodies
    turned = torch.randint(bodies, (n,), generator=rng)
    flip = torch.nn.functional.one_hot(turned, bodies).bool() & alike.unsqueeze(-1)
    return torch.where(flip, -charge, charge)


def all_alike(params: Parameters) -> Parameters:
    """The same bodies, all charged +1: every pair repels, which no training episode shows."""
    assert params.charge is not None
    return replace(params, charge=torch.ones_like(params.charge))


def _signs(shape: tuple[int, int], rng: Generator) -> Tensor:
    return 2.0 * torch.randint(2, shape, generator=rng).double() - 1.0


def _start(params: Parameters, rng: Generator) -> PhaseState:
    shape = (*params.mass.shape, 2)
    return at_rest(normal(shape, POSITION_STD, rng), normal(shape, SPEED_STD, rng), params)


def _softened(source: str) -> PairPotential:
    return SoftenedGravity(SOFTENING, PairLaw(source))
