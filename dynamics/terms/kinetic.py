"""Kinetic energies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynamics.activations import TANH
from dynamics.terms.term import TERMS, KineticTerm, Sizes

if TYPE_CHECKING:
    from dynamics.kinetic import Kinetic


@TERMS.register("fixed")
@dataclass(frozen=True)
class Fixed(KineticTerm):
    """T = sum |p|^2 / 2m; nothing is learned."""

    def build(self, sizes: Sizes) -> Kinetic:
        from dynamics import kinetic

        return kinetic.FixedKinetic()


@TERMS.register("per-body")
@dataclass(frozen=True)
class PerBody(KineticTerm):
    """One learned function of each body's momentum and mass."""

    width: int = 64
    activation: str = TANH

    def build(self, sizes: Sizes) -> Kinetic:
        from dynamics import kinetic

        return kinetic.BodyKinetic(sizes.space, self.width, self.activation)


@TERMS.register("free-kinetic")
@dataclass(frozen=True)
class FreeKinetic(KineticTerm):
    """One network of all momenta and parameters."""

    width: int = 64
    activation: str = TANH

    def build(self, sizes: Sizes) -> Kinetic:
        from dynamics import kinetic

        return kinetic.FreeKinetic(sizes.coordinates, sizes.conditions, self.width, self.activation)
