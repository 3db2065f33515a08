"""Bodies that each follow a law of their own, with springs and contacts between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dynamics.terms.bound import BoundTerm, OnCircle
from dynamics.terms.term import TERMS, HeadTerm, Sizes, Term

if TYPE_CHECKING:
    from dynamics import collide, each


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
