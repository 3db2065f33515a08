"""Kinetic energies."""

from __future__ import annotations

from dataclasses import dataclass

from dynamics import kinetic
from dynamics.mlp import TANH
from dynamics.terms.term import TERMS, KineticTerm, Sizes


@TERMS.register("fixed")
@dataclass(frozen=True)
class Fixed(KineticTerm):
    """T = sum |p|^2 / 2m; nothing is learned."""

    def build(self, sizes: Sizes) -> kinetic.Kinetic:
        return kinetic.FixedKinetic()


@TERMS.register("per-body")
@dataclass(frozen=True)
class PerBody(KineticTerm):
    """One learned function of each body's momentum and mass."""

    width: int = 64
    activation: str = TANH

    def build(self, sizes: Sizes) -> kinetic.Kinetic:
        return kinetic.BodyKinetic(sizes.space, self.width, self.activation)


@TERMS.register("free-kinetic")
@dataclass(frozen=True)
class FreeKinetic(KineticTerm):
    """One network of all momenta and parameters."""

    width: int = 64
    activation: str = TANH

    def build(self, sizes: Sizes) -> kinetic.Kinetic:
        return kinetic.FreeKinetic(sizes.coordinates, sizes.conditions, self.width, self.activation)
