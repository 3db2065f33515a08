"""Potential energies of one body: fields, traps and springs from a fixed place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dynamics.terms.term import TERMS, PotentialTerm, Sizes, dimensions, scaled

if TYPE_CHECKING:
    from dynamics.potentials import Potential


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

        dimensions("Uniform: acceleration", self.acceleration, sizes)
        return fields.UniformField(sizes.space, self.acceleration, self.learned)

    def counted_in(self, length: float, seconds: float) -> Uniform:
        return replace(self, acceleration=_unless(self.acceleration, seconds**2 / length))


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

        dimensions("Trap: centre", self.centre, sizes)
        return potentials.HarmonicTrap(self.stiffness, self.centre, self.learned)

    def counted_in(self, length: float, seconds: float) -> Trap:
        centre = _unless(self.centre, 1 / length)
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
            dimensions("EllipticTrap: the centre, the stiffness and each of its rows", row, sizes)
        return fields.EllipticTrap(self.stiffness, self.centre, self.learned)

    def counted_in(self, length: float, seconds: float) -> EllipticTrap:
        rows = tuple(tuple(x * seconds**2 for x in row) for row in self.stiffness)
        return replace(self, stiffness=rows, centre=scaled(self.centre, 1 / length))


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


@TERMS.register("along")
@dataclass(frozen=True)
class Along(PotentialTerm):
    """A uniform field of the picture, which moves bodies along the curve that they are bound to.

    Args:
        acceleration: world units per second squared, ``(d,)``, of the picture.
        learned: whether it is, from there on.

    Raises:
        ValueError: on building, bodies that are not on a curve whose coordinate is its length.
    """

    acceleration: tuple[float, ...]
    learned: bool = True

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import curves, sliding

        if not isinstance(sizes.curve, curves.ByLength):
            raise ValueError(
                "Along: is of bodies on a line or a drawn curve, as the law of OnLine or OnCurve; "
                "use Uniform for others, and Pendulum on an arc"
            )
        return sliding.Along(sizes.curve, self.acceleration, self.learned)

    def counted_in(self, length: float, seconds: float) -> Along:
        return replace(self, acceleration=scaled(self.acceleration, seconds**2 / length))


@TERMS.register("tether")
@dataclass(frozen=True)
class Tether(PotentialTerm):
    """A spring from a fixed place, V = stiffness (r - rest)^2 / 2 at the distance r from it.

    Args:
        stiffness: per second squared, of a unit mass.
        rest: the distance at which it does not pull, world units.
        centre: the place, ``(d,)``, world units.
        learned: whether they are, from there on.
    """

    stiffness: float
    rest: float
    centre: tuple[float, ...]
    learned: bool = True

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import fields

        dimensions("Tether: centre", self.centre, sizes)
        return fields.Tether(self.stiffness, self.rest, self.centre, self.learned)

    def counted_in(self, length: float, seconds: float) -> Tether:
        return replace(
            self,
            stiffness=self.stiffness * seconds**2,
            rest=self.rest / length,
            centre=scaled(self.centre, 1 / length),
        )


@TERMS.register("centre")
@dataclass(frozen=True)
class Centre(PotentialTerm):
    """A fixed place that pushes bodies away, F = strength (r / near)^-power at the distance r.

    Args:
        strength: at the distance ``near``, world units per second squared, of a unit mass; below
            zero where it pulls.
        power: of the distance, by which it grows less; 2 of a charge or of gravity.
        centre: the place, ``(d,)``, world units.
        near: a distance within those that are seen, world units.
        learned: whether strength, power and place are, from there on.
    """

    strength: float
    power: float
    centre: tuple[float, ...]
    near: float = 1.0
    learned: bool = True

    def build(self, sizes: Sizes) -> Potential:
        from dynamics import fields

        dimensions("Centre: centre", self.centre, sizes)
        return fields.Centre(self.strength, self.power, self.centre, self.near, self.learned)

    def counted_in(self, length: float, seconds: float) -> Centre:
        return replace(
            self,
            strength=self.strength * seconds**2 / length,
            centre=scaled(self.centre, 1 / length),
            near=self.near / length,
        )


def _unless(vector: tuple[float, ...] | None, factor: float) -> tuple[float, ...] | None:
    """A vector times a number, unless there is none."""
    return None if vector is None else scaled(vector, factor)
