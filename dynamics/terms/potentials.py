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


@TERMS.register("uniform")
@dataclass(frozen=True)
class Uniform(PotentialTerm):
    """An acceleration that is the same for every body.

    Args:
        acceleration: world units per second squared, ``(d,)``; zero where not given.
        learned: whether it is, from there on.
    """

    acceleration: tuple[float, ...] | None = None
    learned: bool = True

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import fields

        _dimensions("Uniform: acceleration", self.acceleration, sizes)
        return fields.UniformField(sizes.space, self.acceleration, self.learned)

    def counted_in(self, length: float, seconds: float) -> Uniform:
        return replace(self, acceleration=_scaled(self.acceleration, seconds**2 / length))


@TERMS.register("trap")
@dataclass(frozen=True)
class Trap(PotentialTerm):
    """A harmonic confinement.

    Args:
        stiffness: per second squared, of a unit mass.
        centre: world units, ``(d,)``; the origin where not given.
        learned: whether both are, from there on.
    """

    stiffness: float
    centre: tuple[float, ...] | None = None
    learned: bool = False

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import potentials

        _dimensions("Trap: centre", self.centre, sizes)
        return potentials.HarmonicTrap(self.stiffness, self.centre, self.learned)

    def counted_in(self, length: float, seconds: float) -> Trap:
        centre = _scaled(self.centre, 1 / length)
        return replace(self, stiffness=self.stiffness * seconds**2, centre=centre)


@TERMS.register("elliptic-trap")
@dataclass(frozen=True)
class EllipticTrap(PotentialTerm):
    """A harmonic confinement that differs between directions.

    Args:
        stiffness: a symmetric matrix, row by row, ``(d, d)``, per second squared, of a unit mass.
        centre: world units, ``(d,)``.
        learned: whether both are, from there on.
    """

    stiffness: tuple[tuple[float, ...], ...]
    centre: tuple[float, ...]
    learned: bool = True

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import fields

        for row in (self.centre, self.stiffness, *self.stiffness):
            _dimensions("EllipticTrap: the centre, the stiffness and each of its rows", row, sizes)
        return fields.EllipticTrap(self.stiffness, self.centre, self.learned)

    def counted_in(self, length: float, seconds: float) -> EllipticTrap:
        rows = tuple(tuple(x * seconds**2 for x in row) for row in self.stiffness)
        return replace(self, stiffness=rows, centre=tuple(x / length for x in self.centre))


@TERMS.register("pendulum")
@dataclass(frozen=True)
class Pendulum(PotentialTerm):
    """Weight on a circle, V = -m rate2 length^2 cos(q / length), in one dimension along it.

    Args:
        rate2: square of the rate of small swings, per second squared.
        length: radius in units of the coordinate; 1 where that is an angle.
        learned: whether ``rate2`` is, from there on.
    """

    rate2: float
    length: float = 1.0
    learned: bool = True

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import fields

        return fields.Pendulum(self.rate2, self.length, self.learned)

    def counted_in(self, length: float, seconds: float) -> Pendulum:
        return replace(self, rate2=self.rate2 * seconds**2, length=self.length / length)


@TERMS.register("well")
@dataclass(frozen=True)
class Well(PotentialTerm):
    """F = push - stiffness q + second q^2 - third q^3 of each coordinate: sides that differ.

    Args:
        stiffness, push, second, third: in world units and seconds, of a unit mass.
        learned: whether they are, from there on.
    """

    stiffness: float
    push: float = 0.0
    second: float = 0.0
    third: float = 0.0
    learned: bool = True

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import fields

        return fields.Well(self.stiffness, self.push, self.second, self.third, self.learned)

    def counted_in(self, length: float, seconds: float) -> Well:
        return replace(
            self,
            stiffness=self.stiffness * seconds**2,
            push=self.push * seconds**2 / length,
            second=self.second * seconds**2 * length,
            third=self.third * seconds**2 * length**2,
        )


def _dimensions(what: str, vector: tuple[object, ...] | None, sizes: Sizes) -> None:
    if vector is not None and len(vector) != sizes.space:
        raise ValueError(
            f"{what} must have {sizes.space} numbers, one of each dimension of space, got {vector}"
        )


def _scaled(vector: tuple[float, ...] | None, factor: float) -> tuple[float, ...] | None:
    return None if vector is None else tuple(factor * x for x in vector)


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
