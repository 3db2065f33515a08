"""Ports: friction, heat baths and impulses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from dynamics.terms.term import TERMS, PortTerm, Sizes, scaled

if TYPE_CHECKING:
    from dynamics import bath
    from dynamics.friction import Friction
    from dynamics.ports import Port


@TERMS.register("linear-friction")
@dataclass(frozen=True)
class LinearFriction(PortTerm):
    """dp/dt = -gamma p with a learned gamma > 0."""

    def build(self, sizes: Sizes) -> Port:
        from dynamics import ports

        return ports.LinearFriction()


@TERMS.register("drag")
@dataclass(frozen=True)
class Drag(PortTerm):
    """Friction that opposes velocity, of bodies or of joints; see :class:`Friction`.

    Args:
        law: ``linear``, ``square`` or ``dry``.
        strength: ``positive``, ``free``, ``factored``, ``guaranteed`` or ``known``.
        rate: where it starts; per second, per world unit, or an acceleration, as the law is.
    """

    law: str = "linear"
    strength: str = "positive"
    rate: float | None = None

    def build(self, sizes: Sizes) -> Friction:
        from dynamics.friction import Friction

        return Friction(self.law, self.strength, self.rate)

    def counted_in(self, length: float, seconds: float) -> Drag:
        told = self.strength not in ("positive", "free")  # a multiple, which has no unit
        if self.rate is None or told:
            return self
        unit = {"linear": seconds, "square": length, "dry": seconds**2 / length}[self.law]
        return replace(self, rate=self.rate * unit)


@TERMS.register("turning")
@dataclass(frozen=True)
class Turning(PortTerm):
    """A force across the way that goes with the speed, rate x v: a magnetic field's.

    Args:
        rate: at which velocities turn, radians per second: one number in the plane, three in space.
        learned: whether it is, from there on.
    """

    rate: tuple[float, ...]
    learned: bool = True

    def build(self, sizes: Sizes) -> Port:
        from dynamics import ports

        if (len(self.rate), sizes.space) not in ((1, 2), (3, 3)):
            raise ValueError(
                f"Turning: rate must have one number in the plane and three in space, got "
                f"{self.rate} in {sizes.space} dimensions"
            )
        return ports.Turning(self.rate, self.learned)

    def counted_in(self, length: float, seconds: float) -> Turning:
        return replace(self, rate=scaled(self.rate, seconds))


@TERMS.register("placewise-friction")
@dataclass(frozen=True)
class PlacewiseFriction(PortTerm):
    """Friction on a line that changes with the place, and may add energy somewhere.

    Args:
        rates: a, b and c of -(a + b q + c q^2) dq/dt, per second and per world unit.
        learned: whether they are, from there on.
    """

    rates: tuple[float, float, float]
    learned: bool = True

    def build(self, sizes: Sizes) -> Port:
        from dynamics import ports

        if sizes.space != 1:
            raise ValueError(
                f"PlacewiseFriction: acts on a line, got {sizes.space} dimensions of space"
            )
        return ports.PlacewiseFriction(self.rates, self.learned)

    def counted_in(self, length: float, seconds: float) -> PlacewiseFriction:
        a, b, c = scaled(self.rates, seconds)
        return replace(self, rates=(a, b * length, c * length**2))


@TERMS.register("restitution")
@dataclass(frozen=True)
class Restitution(PortTerm):
    """Overlapping bodies that approach bounce with a learned restitution."""

    def build(self, sizes: Sizes) -> Port:
        from dynamics import contact

        return contact.Restitution(sizes.box)


@TERMS.register("free-impulse")
@dataclass(frozen=True)
class FreeImpulse(PortTerm):
    """An impulse between pairs that is any function of distance and speeds."""

    width: int = 64

    def build(self, sizes: Sizes) -> Port:
        from dynamics import contact

        return contact.FreeImpulse(sizes.box, self.width)


@TERMS.register("bath")
@dataclass(frozen=True)
class Bath(PortTerm):
    """Diagonal friction that is positive, and the noise that belongs to it."""

    made: ClassVar[str] = "PassiveBath"  # in :mod:`dynamics.bath`

    def build(self, sizes: Sizes) -> bath.Bath:
        from dynamics import bath

        made: type[bath.Bath] = getattr(bath, self.made)
        return made(sizes.bodies, sizes.space)


@TERMS.register("untied-bath")
@dataclass(frozen=True)
class UntiedBath(Bath):
    """The same with noise that is learned apart from the friction."""

    made = "UntiedBath"


@TERMS.register("full-bath")
@dataclass(frozen=True)
class FullBath(Bath):
    """Friction between all coordinates, with correlated noise."""

    made = "FullBath"


@TERMS.register("factored-bath")
@dataclass(frozen=True)
class FactoredBath(Bath):
    """A learned positive multiple of the friction that is told."""

    made = "FactoredBath"


@TERMS.register("constant-bath")
@dataclass(frozen=True)
class ConstantBath(Bath):
    """One learned friction; no drive.

    Args:
        rate: where it starts, per second.
    """

    rate: float | None = None

    def build(self, sizes: Sizes) -> bath.ConstantBath:
        from dynamics import bath

        return bath.ConstantBath(sizes.bodies, sizes.space, self.rate)

    def counted_in(self, length: float, seconds: float) -> ConstantBath:
        return self if self.rate is None else replace(self, rate=self.rate * seconds)


@TERMS.register("driven-bath")
@dataclass(frozen=True)
class DrivenBath(Bath):
    """One learned friction, less a learned multiple of the drive that is told."""

    made = "DrivenBath"


@TERMS.register("state-dependent-bath")
@dataclass(frozen=True)
class StateDependentBath(Bath):
    """Refused: a friction that depends on the state."""

    def build(self, sizes: Sizes) -> bath.Bath:
        """Refuse.

        Raises:
            NotImplementedError: always; it needs a spurious drift T div M and a stated convention,
                and neither the study's result nor the exact step covers it.
        """
        raise NotImplementedError(
            "state-dependent-bath: a mobility that depends on the state needs the drift T div M "
            "and a stated convention (Ito or Stratonovich); the exact step holds for constant "
            "coefficients only: use a bath whose friction depends on the parameters, or the "
            "neural SDE (Ito)"
        )
