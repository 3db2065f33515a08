"""Models of bodies that are bound to something, or each follow a law of their own."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

from dynamics.terms.ports import Drag
from dynamics.terms.term import TERMS, HeadTerm, Sizes, Term
from registry import unknown

if TYPE_CHECKING:
    from dynamics import collide, curves, each, links
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
        return Bound(curve, self.law.build(replace(sizes, space=1, box=None)))


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
            point=_scaled(self.point, 1 / length),
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
            pivot=_scaled(self.pivot, 1 / length),
            across=_scaled(self.across, 1 / length),
            down=_scaled(self.down, 1 / length),
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
    """

    points: tuple[tuple[float, ...], ...]
    law: HeadTerm

    def curve(self) -> curves.Curve:
        from dynamics import curves

        return curves.Drawn(self.points)

    def counted_in(self, length: float, seconds: float) -> OnCurve:
        points = tuple(_scaled(point, 1 / length) for point in self.points)
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


@TERMS.register("spring")
@dataclass(frozen=True)
class Spring(Term):
    """Pulls two bodies' coordinates s_i and s_j together; see :class:`Each`.

    Args:
        first, second: indices i and j of the bodies, from 0.
        stiffness: per second squared, of unit masses.
        rest: s_i - s_j where it does not pull, in the coordinates' unit.
        apart: of pendulums whose ends it joins, from the first one's pivot to the second one's
            along a level line, over their length; it is then ``rest`` longer than that where it
            does not pull. 0: it joins the coordinates.
        learned: whether stiffness and rest are, from there on.
    """

    first: int
    second: int
    stiffness: float
    rest: float = 0.0
    apart: float = 0.0
    learned: bool = True

    def build(self, sizes: Sizes) -> each.Spring:
        from dynamics import each

        _two_of("Spring", self.first, self.second, sizes)
        ends = self.first, self.second
        return each.Spring(*ends, self.stiffness, self.rest, self.apart, self.learned)

    def counted_in(self, length: float, seconds: float) -> Spring:
        return replace(self, stiffness=self.stiffness * seconds**2, rest=self.rest / length)


@TERMS.register("contact")
@dataclass(frozen=True)
class Contact(Term):
    """Two bodies that collide; see :class:`Each` and :class:`dynamics.collide.Contact`.

    Args:
        first, second: indices i and j of the bodies, from 0.
        reach: their distance as they touch, in the coordinates' unit.
        restitution: speed at which they part over that at which they met.
        rub: share of the speed across the line between them that a collision takes.
        side: on a line, 1 where the second lies ahead of the first, else -1.
        learned: whether reach and restitution are, from there on.
    """

    first: int
    second: int
    reach: float
    restitution: float
    rub: float = 0.0
    side: float = 1.0
    learned: bool = True

    def build(self, sizes: Sizes) -> collide.Contact:
        from dynamics import collide

        _two_of("Contact", self.first, self.second, sizes)
        return collide.Contact(
            self.first,
            self.second,
            self.reach,
            self.restitution,
            self.rub,
            self.side,
            self.learned,
        )

    def counted_in(self, length: float, seconds: float) -> Contact:
        return replace(self, reach=self.reach / length)


@TERMS.register("each")
@dataclass(frozen=True)
class Each(HeadTerm):
    """A law for each body, and springs and contacts between their coordinates.

    Args:
        laws: of one body each, in the bodies' order.
        springs: between bodies on curves, or in one dimension of space.
        contacts: of bodies that may collide.

    Example:
        Two carts on one rail, each on a spring of its own, and one between them:

        >>> from dynamics import build, terms
        >>> cart = terms.Hamiltonian(potentials=(terms.Trap(9.0),))
        >>> pair = terms.Each((cart, cart), (terms.Spring(0, 1, stiffness=2.0),))
        >>> len(build(pair, bodies=2, dt=0.01, space=1).laws)
        2
    """

    laws: tuple[HeadTerm, ...]
    springs: tuple[Spring, ...] = ()
    contacts: tuple[Contact, ...] = ()

    def build(self, sizes: Sizes) -> each.Each:
        from dynamics import each

        if len(self.laws) != sizes.bodies:
            raise ValueError(
                f"Each: laws must have {sizes.bodies} entries, one of each body, got "
                f"{len(self.laws)}"
            )
        springs = [spring.build(sizes) for spring in self.springs]
        for spring in self.springs:
            for body in (spring.first, spring.second):
                if sizes.space > 1 and not isinstance(self.laws[body], BoundTerm):
                    raise ValueError(
                        f"Each: a spring acts along curves, but body {body} is free in "
                        f"{sizes.space} dimensions; bind it, or use a pair's potential"
                    )
        one = replace(sizes, bodies=1, conditions=sizes.conditions - sizes.bodies + 1)
        laws = [law.build(one) for law in self.laws]
        return each.Each(laws, springs, [contact.build(sizes) for contact in self.contacts])

    def counted_in(self, length: float, seconds: float) -> Each:
        def unit(pair: Spring | Contact) -> float:
            return 1.0 if isinstance(self.laws[pair.first], OnCircle) else length

        return Each(
            tuple(law.counted_in(length, seconds) for law in self.laws),
            tuple(spring.counted_in(unit(spring), seconds) for spring in self.springs),
            tuple(contact.counted_in(unit(contact), seconds) for contact in self.contacts),
        )


def _two_of(what: str, first: int, second: int, sizes: Sizes) -> None:
    bodies = range(sizes.bodies)
    if first not in bodies or second not in bodies or first == second:
        raise ValueError(
            f"{what}: joins two of {sizes.bodies} bodies, counted from 0, got {first} and {second}"
        )


def _scaled(vector: tuple[float, ...], factor: float) -> tuple[float, ...]:
    return tuple(factor * x for x in vector)
