"""Potential energies: of pairs, of triples, of one body, and of all positions at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dynamics.activations import TANH
from dynamics.terms.term import TERMS, PotentialTerm, Sizes

if TYPE_CHECKING:
    from dynamics.couplings import PairLaw
    from dynamics.potentials import Potential


SHAPE_LENGTHS = {  # shape of a pair force: powers of length in the unit of its strength
    "inverse-square": 3,
    "point": 3,
    "inverse": 2,
    "inverse-cube": 4,
    "gaussian": 0,
    "cut-off": 0,
    "contact": 0,
    "spring": 0,
    "rest-length": 1,
    "twelve": 14,
    "six": 8,
}


def summed(terms: Sequence[PotentialTerm], sizes: Sizes) -> Potential:
    """The potential that is all of these together."""
    from dynamics import potentials

    parts = [term.build(sizes) for term in terms]
    return parts[0] if len(parts) == 1 else potentials.SumPotential(parts)


@dataclass(frozen=True)
class Pair(PotentialTerm):
    """What all pair laws have: V = c(G) sum_{i<j} s_i s_j phi(q_i - q_j), see :class:`PairLaw`.

    Args:
        source: the property s of a body: ``mass``, ``charge`` or ``alike``.
        coupling: the function c: ``linear``, ``even``, ``quadratic`` or ``cubic``.
    """

    source: str = "mass"
    coupling: str = "linear"

    def law(self, sizes: Sizes) -> PairLaw:
        """All of it but phi."""
        from dynamics.couplings import PairLaw

        return PairLaw(self.source, self.coupling, sizes.box)


@TERMS.register("displacement")
@dataclass(frozen=True)
class Displacement(Pair):
    """phi learned from the displacement vector."""

    width: int = 64
    activation: str = TANH

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import potentials

        law = self.law(sizes)
        return potentials.DisplacementPotential(sizes.space, self.width, self.activation, law)


@TERMS.register("radial")
@dataclass(frozen=True)
class Radial(Pair):
    """phi learned from the distance alone."""

    width: int = 64
    activation: str = TANH

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import potentials

        return potentials.RadialPotential(self.width, self.activation, self.law(sizes))


@TERMS.register("knots")
@dataclass(frozen=True)
class Knots(Pair):
    """A force of finite range, linear between learned distances.

    Args:
        source, coupling: see :class:`Pair`.
        knots: number of distances.
        reach: world units; up to which they are spread at first.
    """

    knots: int = 64
    reach: float = 1.0

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import contact

        return contact.KnotPotential(self.knots, self.reach, self.law(sizes))

    def counted_in(self, length: float, seconds: float) -> Knots:
        return replace(self, reach=self.reach / length)


@TERMS.register("shaped")
@dataclass(frozen=True)
class Shaped(Pair):
    """A pair force of a known shape.

    Args:
        source, coupling: see :class:`Pair`.
        shape: of :data:`dynamics.shapes.SHAPES`, as ``inverse-square`` (softened) or ``spring``.
        strength: of the force, which pulls where it is above zero (a contact pushes); see
            :class:`dynamics.shapes.ShapedPotential`.
        length: in the shape, world units; of no meaning where the shape has none.
        learned: whether strength and length are, from there on.

    Example:
        Two bodies that pull each other with a constant force and part near each other:

        >>> from dynamics import build, terms
        >>> pull, push = terms.Shaped(shape="rest-length"), terms.Shaped(shape="contact")
        >>> pair = build(terms.Hamiltonian(potentials=(pull, push)), bodies=2, dt=0.01)
        >>> sorted(name for name, _ in pair.named_parameters())[-1]
        'potential.parts.1.strength'
    """

    shape: str = "inverse-square"
    strength: float = 1.0
    length: float = 1.0
    learned: bool = True

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import shapes

        return shapes.ShapedPotential(
            self.shape, self.strength, self.length, self.learned, self.law(sizes)
        )

    def counted_in(self, length: float, seconds: float) -> Shaped:
        strength = self.strength * seconds**2 / length ** SHAPE_LENGTHS[self.shape]
        return replace(self, strength=strength, length=self.length / length)


@TERMS.register("triple")
@dataclass(frozen=True)
class Triple(PotentialTerm):
    """A learned function of each three bodies; ``coupling`` as of a :class:`Pair`."""

    coupling: str = "linear"
    width: int = 64
    activation: str = TANH

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import triples

        return triples.LearnedTriple(self.width, self.activation, self.coupling)


@TERMS.register("mapped")
@dataclass(frozen=True)
class Mapped(PotentialTerm):
    """A network of all positions with an output for each feature of the coupling.

    Args:
        features: of the coupling: ``linear``, ``localised`` or ``gain``, see
            :mod:`dynamics.coupling_maps`.
        width, activation: of the network.
    """

    features: str = "linear"
    width: int = 64
    activation: str = TANH

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import coupling_maps

        return coupling_maps.MappedPotential(
            sizes.coordinates, self.width, self.activation, self.features
        )


@TERMS.register("free-potential")
@dataclass(frozen=True)
class FreePotential(PotentialTerm):
    """One network of all positions and parameters."""

    width: int = 64
    activation: str = TANH

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import potentials

        return potentials.FreePotential(
            sizes.coordinates, sizes.conditions, self.width, self.activation
        )


@TERMS.register("no-potential")
@dataclass(frozen=True)
class NoPotential(PotentialTerm):
    """V = 0."""

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import potentials

        return potentials.NoPotential()


@TERMS.register("shortcut")
@dataclass(frozen=True)
class Shortcut(PotentialTerm):
    """Potentials, and beside them a force between pairs that may be anything.

    Args:
        beside: the potentials.
        width: of the free force's network.
    """

    beside: tuple[PotentialTerm, ...]
    width: int = 64

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import hybrid

        whole = summed(self.beside, sizes)
        return hybrid.Shortcut(whole, sizes.space, self.width, sizes.box)
