"""What acts by a clock, and models that it acts on."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dynamics.terms.heads import Hamiltonian
from dynamics.terms.term import TERMS, HeadTerm, Sizes, Term, dimensions, scaled

if TYPE_CHECKING:
    from dynamics import clocked


class TimedTerm(Term):
    """What changes with time."""

    @abstractmethod
    def build(self, sizes: Sizes) -> clocked.Timed: ...


@TERMS.register("sinusoid")
@dataclass(frozen=True)
class Sinusoid(TimedTerm):
    """Pushes all bodies by a sinusoid of the time, as a motor does.

    Args:
        along, across: accelerations that go with its cosine and its sine, ``(d,)``, world units per
            second squared.
        rate: radians per second.
        learned: whether all three are, from there on.
    """

    along: tuple[float, ...]
    across: tuple[float, ...]
    rate: float
    learned: bool = True

    def build(self, sizes: Sizes) -> clocked.Timed:
        from dynamics import clocked

        dimensions("Sinusoid: along", self.along, sizes)
        dimensions("Sinusoid: across", self.across, sizes)
        return clocked.Sinusoid(self.along, self.across, self.rate, self.learned)

    def counted_in(self, length: float, seconds: float) -> Sinusoid:
        unit = seconds**2 / length
        along, across = scaled(self.along, unit), scaled(self.across, unit)
        return replace(self, along=along, across=across, rate=self.rate * seconds)


@TERMS.register("lift")
@dataclass(frozen=True)
class Lift(TimedTerm):
    """Pushes what spins across its way in the plane, and less as its spin fades.

    Args:
        rate: at which velocities turn where the clock shows 0, radians per second.
        fades: share of it a second by which the spin fades.
        learned: whether the rate is, from there on.
    """

    rate: float
    fades: float
    learned: bool = True

    def build(self, sizes: Sizes) -> clocked.Timed:
        from dynamics import clocked

        if sizes.space != 2:
            raise ValueError(f"Lift: acts in the plane, got {sizes.space} dimensions of space")
        return clocked.Lift(self.rate, self.fades, self.learned)

    def counted_in(self, length: float, seconds: float) -> Lift:
        return replace(self, rate=self.rate * seconds, fades=self.fades * seconds)


@TERMS.register("clocked")
@dataclass(frozen=True)
class Clocked(HeadTerm):
    """A model beside which something acts that changes with time; parameters have a ``clock``.

    Args:
        free: the model without it.
        timed: what acts.
    """

    free: Hamiltonian
    timed: tuple[TimedTerm, ...]

    def build(self, sizes: Sizes) -> clocked.Clocked:
        from dynamics import clocked

        return clocked.Clocked(self.free.build(sizes), [part.build(sizes) for part in self.timed])
