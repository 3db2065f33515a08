"""Bodies that attract each other and strike: softened gravity, and a contact where disks touch."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dynamics import Hamiltonian, Parameters, PhaseState
from dynamics.contact import SoftContact
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity, SumPotential
from vidphys.scenes.gravity import SOFTENING, gravity
from vidphys.scenes.scene import Sampler, Scene, closest

DIAMETER = 0.7  # world units: twice the radius of a disk as it is drawn
HARDNESS = 100.0  # stiffness of the contact over G: a strike takes about 0.2 s


class Strike(SoftContact):
    """The contact, ``HARDNESS`` times as stiff as G."""

    def pair_energy(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        return HARDNESS * super().pair_energy(displacement)

    def pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        return HARDNESS * super().pair_gradient(displacement)


def strikes() -> Scene:
    """Three unit masses under H = K + G sum_{i<j} (phi(r) + 100 max(0.7 - r, 0)^2 / 2).

    phi is that of softened gravity. Both parts have one coupling, so that a single pair law is
    their sum. All bodies start apart.

    Example:
        >>> scene = strikes()
        >>> start, law = scene.sample(64, Generator().manual_seed(0))
        >>> bool((closest(start.q) >= DIAMETER).all())
        True
    """
    free = gravity(mass=(1.0, 1.0))
    law = Hamiltonian(FixedKinetic(), SumPotential([SoftenedGravity(SOFTENING), Strike(DIAMETER)]))
    settings = {**free.settings, "diameter": DIAMETER, "hardness": HARDNESS}
    return replace(free, name="strikes", law=law, sample=_apart(free.sample), settings=settings)


def _apart(free: Sampler) -> Sampler:
    """The same starts but for those in which two bodies touch."""

    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        states: list[PhaseState] = []
        laws: list[Parameters] = []
        while sum(map(len, (state.q for state in states))) < n:
            start, params = free(n, rng)
            apart = closest(start.q) >= DIAMETER
            states.append(start[apart])
            laws.append(params[apart])
        q, p = (torch.cat([getattr(state, x) for state in states]) for x in "qp")
        return PhaseState(q, p)[:n], Parameters.cat(laws)[:n]

    return sample
