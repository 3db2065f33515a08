"""Models of bodies that are bound to curves, to chains of rods, or to strings."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

from dynamics.terms.heads import Hamiltonian
from dynamics.terms.ports import Drag
from dynamics.terms.term import TERMS, HeadTerm, Sizes, dimensions, scaled
from registry import unknown

if TYPE_CHECKING:
    from dynamics import curves, links, sliding, strings
    from dynamics.bound import Bound

B = TypeVar("B", bound="OnCircle")


class BoundTerm(HeadTerm):
    """A model seen in the picture, whose ``law`` is of the one dimension along a curve."""

    law: HeadTerm

    @abstractmethod
    def curve(self) -> curves.Curve:
        """Where the bodies may be."""

    def build(self, sizes: Sizes) -> Bound:
        from dynamics.bound import Bound

        curve = self.curve()
        within = replace(sizes, space=1, box=None, curve=curve)
        return Bound(curve, self.law.build(within))


@TERMS.register("on-line")
@dataclass(frozen=True)
class OnLine(BoundTerm):
    """Bodies on a straight rail; the coordinate is the way along it in world units.

    Args:
        point: on the rail, ``(d,)``, world units; where the coordinate is zero.
        direction: in which it grows, ``(d,)``.
        law: of the bodies along it.

    Example:
        >>> from dynamics import build, terms
        >>> spring = terms.Hamiltonian(potentials=(terms.Trap(4.0),))
        >>> cart = terms.OnLine(point=(0.0, 1.0), direction=(1.0, 0.2), law=spring)
        >>> build(cart, bodies=1, dt=0.01).curve.along.tolist()[0] > 0.98
        True
    """

    point: tuple[float, ...]
    direction: tuple[float, ...]
    law: HeadTerm

    def curve(self) -> curves.Curve:
        from dynamics import curves

        return curves.Line(self.point, self.direction)

    def counted_in(self, length: float, seconds: float) -> OnLine:
        return replace(
            self,
            point=scaled(self.point, 1 / length),
            law=self.law.counted_in(length, seconds),
        )


@dataclass(frozen=True)
class OnCircle(BoundTerm):
    """What arcs and chains have; see :class:`dynamics.curves.Arc`. Coordinates are radians."""

    pivot: tuple[float, ...]
    across: tuple[float, ...]
    down: tuple[float, ...]

    def counted_in(self: B, length: float, seconds: float) -> B:
        law = {"law": self.law.counted_in(1.0, seconds)}  # of angles
        return replace(
            self,
            pivot=scaled(self.pivot, 1 / length),
            across=scaled(self.across, 1 / length),
            down=scaled(self.down, 1 / length),
            **law,
        )


@TERMS.register("on-arc")
@dataclass(frozen=True)
class OnArc(OnCircle):
    """Bodies on a circle, as a camera sees it: place = pivot + across sin s + down cos s.

    The coordinate s is in radians, and so are lengths in the law.

    Args:
        pivot: the centre, ``(d,)``, world units.
        across: from it to where s is a quarter turn, ``(d,)``; of the length of ``down`` and at
            right angles to it where the camera looks straight.
        down: from it to where s = 0, ``(d,)``.
        law: of the angles.

    Example:
        A pendulum of length 0.5 m with some friction, y upwards:

        >>> from dynamics import build, terms
        >>> weight = terms.Pendulum(rate2=9.81 / 0.5)
        >>> law = terms.Hamiltonian(potentials=(weight,), ports=(terms.Drag(rate=0.05),))
        >>> pendulum = terms.OnArc((0.0, 1.0), across=(0.5, 0.0), down=(0.0, -0.5), law=law)
        >>> build(pendulum, bodies=1, dt=0.01).conserves
        False
    """

    law: HeadTerm

    def curve(self) -> curves.Curve:
        from dynamics import curves

        return curves.Arc(self.pivot, self.across, self.down)


@TERMS.register("on-curve")
@dataclass(frozen=True)
class OnCurve(BoundTerm):
    """Bodies on a smooth curve through points; the coordinate is the way along it from the first.

    Args:
        points: ``(k, d)``, world units; see :class:`dynamics.curves.Drawn`.
        law: of the bodies along it.

    Example:
        A bead in a bowl, y upwards, whose dry friction is a tenth of what presses it to the bowl:

        >>> from dynamics import build, terms
        >>> bowl = tuple((x / 4, (x / 4) ** 2) for x in range(-4, 5))
        >>> fall = terms.Hamiltonian(potentials=(terms.Along((0.0, -9.81)),))
        >>> head = build(terms.OnCurve(bowl, terms.Rubbed(fall, coefficient=0.1)), 1, dt=0.01)
        >>> round(head.curve.length, 2)
        2.96
    """

    points: tuple[tuple[float, ...], ...]
    law: HeadTerm

    def curve(self) -> curves.Curve:
        from dynamics import curves

        return curves.Drawn(self.points)

    def counted_in(self, length: float, seconds: float) -> OnCurve:
        points = tuple(scaled(point, 1 / length) for point in self.points)
        return replace(self, points=points, law=self.law.counted_in(length, seconds))


@TERMS.register("on-chain")
@dataclass(frozen=True)
class OnChain(OnCircle):
    """The ends of rods that hang end on end; coordinates are the rods' angles.

    Args:
        pivot, across, down: see :class:`OnArc`; ``across`` and ``down`` in world units for each
            unit of length.
        lengths: of the rods, one for each body.
        law: of the angles, such as :class:`Links`.
    """

    lengths: tuple[float, ...]
    law: HeadTerm

    def curve(self) -> curves.Curve:
        from dynamics import curves

        return curves.Chain(self.pivot, self.across, self.down, self.lengths)

    def build(self, sizes: Sizes) -> Bound:
        if len(self.lengths) != sizes.bodies:
            raise ValueError(
                f"OnChain: lengths must have {sizes.bodies} numbers, one of each body, got "
                f"{self.lengths}"
            )
        return super().build(sizes)


@TERMS.register("rubbed")
@dataclass(frozen=True)
class Rubbed(HeadTerm):
    """Dry friction on a curve, a share of what presses the bodies to it; see :class:`OnCurve`.

    Args:
        free: the model without it, whose potentials have an :class:`Along`.
        coefficient: that share, zero or above.
        learned: whether it is, from there on.
    """

    free: Hamiltonian
    coefficient: float
    learned: bool = True

    def build(self, sizes: Sizes) -> sliding.Rubbed:
        from dynamics import sliding

        return sliding.Rubbed(self.free.build(sizes), self.coefficient, self.learned)


@TERMS.register("strung")
@dataclass(frozen=True)
class Strung(HeadTerm):
    """Bodies on strings from a fixed place, which go slack and catch them again.

    Args:
        free: the model without the strings.
        centre: where they hang, ``(d,)``, world units.
        length: of each, world units.
        learned: whether both are, from there on.

    Example:
        >>> from dynamics import build, terms
        >>> fall = terms.Hamiltonian(potentials=(terms.Uniform((0.0, -9.81)),))
        >>> build(terms.Strung(fall, centre=(0.0, 1.0), length=0.5), bodies=1, dt=0.01).conserves
        False
    """

    free: Hamiltonian
    centre: tuple[float, ...]
    length: float
    learned: bool = True

    def build(self, sizes: Sizes) -> strings.Strung:
        from dynamics import strings

        dimensions("Strung: centre", self.centre, sizes)
        return strings.Strung(self.free.build(sizes), self.centre, self.length, self.learned)

    def counted_in(self, length: float, seconds: float) -> Strung:
        changed = super().counted_in(length, seconds)
        return replace(changed, centre=scaled(self.centre, 1 / length), length=self.length / length)


@TERMS.register("links")
@dataclass(frozen=True)
class Links(HeadTerm):
    """Rods that hang end on end, in their angles from hanging straight down.

    Args:
        lengths: of the rods.
        masses: at their ends; only their ratios mean anything.
        gravity: in units of ``lengths`` per second squared.
        inertia: of each rod beyond that of the mass at its end; none where not given.
        ports: friction at the joints.
        integrator: of :data:`dynamics.INTEGRATORS`, for a field that is not separable.
        learned: whether masses, inertia and gravity are, from there on.
    """

    lengths: tuple[float, ...]
    masses: tuple[float, ...]
    gravity: float
    inertia: tuple[float, ...] | None = None
    ports: tuple[Drag, ...] = ()
    integrator: str = "rk4"
    learned: bool = True

    def build(self, sizes: Sizes) -> links.Links:
        from dynamics import links
        from dynamics.generalised import GeneralisedHamiltonian
        from dynamics.integrators import INTEGRATORS

        inertia = self.inertia or (0.0,) * len(self.lengths)
        for name, found in (("lengths", self.lengths), ("masses", self.masses)):
            if len(found) != sizes.bodies or len(inertia) != sizes.bodies:
                raise ValueError(
                    f"Links: {name} and inertia must have {sizes.bodies} numbers, one of each "
                    f"body, got {found} and {inertia}"
                )
        if self.integrator not in INTEGRATORS:
            raise unknown("integrator", self.integrator, INTEGRATORS)
        metric = links.LinkMetric(self.lengths, self.masses, inertia, self.learned)
        within = GeneralisedHamiltonian(
            metric,
            links.Hanging(metric, self.gravity, self.learned),
            INTEGRATORS[self.integrator],
            sizes.dt,
            [port.build(sizes) for port in self.ports],
        )
        return links.Links(within)

    def counted_in(self, length: float, seconds: float) -> Links:
        """Only time: angles have no unit, and lengths keep theirs.

        Raises:
            ValueError: another unit of angles.
        """
        if length != 1.0:
            raise ValueError(f"Links: angles are in radians and cannot be counted in {length}")
        ports = tuple(port.counted_in(1.0, seconds) for port in self.ports)
        return replace(self, gravity=self.gravity * seconds**2, ports=ports)
