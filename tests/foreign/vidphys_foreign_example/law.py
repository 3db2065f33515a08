"""A screened attraction, phi = -exp(-r / reach) / r, whose reach is learned; and a head with it."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from dynamics.potentials import PairPotential
from dynamics.terms import Hamiltonian, PotentialTerm, Sizes


class YukawaPotential(PairPotential):
    """Of all pairs; the distance is softened."""

    def __init__(self, reach: float, softening: float) -> None:
        super().__init__()
        self.softening = softening
        self.logarithm = nn.Parameter(torch.tensor(reach).log())

    def _distance(self, displacement: Tensor) -> Tensor:
        return (displacement.square().sum(-1, keepdim=True) + self.softening**2).sqrt()

    def pair_energy(self, displacement: Tensor) -> Tensor:
        r = self._distance(displacement)
        return (-torch.exp(-r / self.logarithm.exp()) / r).squeeze(-1)

    def pair_gradient(self, displacement: Tensor) -> Tensor:
        r, reach = self._distance(displacement), self.logarithm.exp()
        return torch.exp(-r / reach) * (1 / r + 1 / reach) / r * displacement / r


@dataclass(frozen=True)
class Yukawa(PotentialTerm):
    """Screened attraction.

    Args:
        reach: world units over which it falls by a factor e; where learning starts.
        softening: world units.
    """

    reach: float = 0.5
    softening: float = 0.2

    def build(self, sizes: Sizes) -> YukawaPotential:
        return YukawaPotential(self.reach, self.softening)


SCREENED = Hamiltonian(potentials=(Yukawa(),))
