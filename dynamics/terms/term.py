"""What a term is: a part of a model as data, which builds the module it stands for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

from registry import Registry, unknown

if TYPE_CHECKING:
    from dynamics.curves import Curve
    from dynamics.head import Head
    from dynamics.kinetic import Kinetic
    from dynamics.ports import Port
    from dynamics.potentials import Potential

T = TypeVar("T", bound="Term")


@dataclass(frozen=True)
class Sizes:
    """What a term is told of its scene when it is built.

    Args:
        bodies, space: N and d.
        conditions: entries of the parameters' vector, for networks that are given it.
        dt: seconds of one application of a transition map.
        box: side of the periodic box in world units, or ``None``.
        curve: that the bodies are bound to, or ``None``.
    """

    bodies: int
    space: int
    conditions: int
    dt: float
    box: float | None = None
    curve: Curve | None = None

    @property
    def coordinates(self) -> int:
        """Entries of q."""
        return self.bodies * self.space


@dataclass(frozen=True)
class Term(ABC):
    """A part of a model. A new one is a frozen dataclass with a ``build``.

    Under ``@TERMS.register("cup")``, or the entry point ``cup``, it is known by that name in
    configurations; without, by its import path.

    Example:
        >>> from dynamics import build, terms
        >>> from dynamics.potentials import HarmonicTrap
        >>> @dataclass(frozen=True)
        ... class Cup(terms.PotentialTerm):
        ...     depth: float = 1.0
        ...
        ...     def build(self, sizes):
        ...         return HarmonicTrap(self.depth / sizes.bodies)
        >>> head = build(terms.Hamiltonian(potentials=(Cup(3.0),)), bodies=2, dt=0.01)
        >>> head.potential.stiffness
        1.5
    """

    @abstractmethod
    def build(self, sizes: Sizes) -> Any:
        """The module, randomly initialised from torch's global generator."""

    def counted_in(self: T, length: float, seconds: float) -> T:
        """The same where world units are ``length`` and seconds ``seconds`` of those before.

        A term whose own numbers have a unit converts them and leaves its parts to this.
        """
        return self.with_parts(lambda part: part.counted_in(length, seconds))

    def throughout(self: T, **values: Any) -> T:
        """The same with these fields changed in every part that has them, itself among them.

        Raises:
            ValueError: no part has such a field.
        """
        known = {field.name for part in self.parts() for field in fields(part)}
        for name in values:
            if name not in known:
                raise unknown(f"field of {type(self).__name__}", name, sorted(known))
        return self._changed(values)

    def parts(self) -> Iterator[Term]:
        """This term, then all that it is made of."""
        yield self
        for field in fields(self):
            held = getattr(self, field.name)
            for part in held if isinstance(held, tuple) else (held,):
                if isinstance(part, Term):
                    yield from part.parts()

    def with_parts(self: T, change: Callable[[Term], Term]) -> T:
        """The same, each of the parts that it is made of changed by a function."""

        def changed(held: Any) -> Any:
            if isinstance(held, tuple):
                return tuple(changed(part) for part in held)
            return change(held) if isinstance(held, Term) else held

        return replace(self, **{x.name: changed(getattr(self, x.name)) for x in fields(self)})

    def _changed(self: T, values: Mapping[str, Any]) -> T:
        changed = self.with_parts(lambda part: part._changed(values))
        own = {field.name for field in fields(self)}
        return replace(changed, **{name: x for name, x in values.items() if name in own})


class HeadTerm(Term):
    """A whole model."""

    @abstractmethod
    def build(self, sizes: Sizes) -> Head: ...


class KineticTerm(Term):
    """A kinetic energy T(p)."""

    @abstractmethod
    def build(self, sizes: Sizes) -> Kinetic: ...


class PotentialTerm(Term):
    """A potential energy V(q, c)."""

    @abstractmethod
    def build(self, sizes: Sizes) -> Potential: ...


class PortTerm(Term):
    """Where energy enters or leaves."""

    @abstractmethod
    def build(self, sizes: Sizes) -> Port: ...


TERMS: Registry[type[Term]] = Registry("term", "vidphys.terms")


def dimensions(what: str, vector: tuple[object, ...] | None, sizes: Sizes) -> None:
    """Refuse a vector that has not one number for each dimension of space.

    Raises:
        ValueError: what it is, and how many it must have.
    """
    if vector is not None and len(vector) != sizes.space:
        raise ValueError(
            f"{what} must have {sizes.space} numbers, one of each dimension of space, got {vector}"
        )


def scaled(vector: tuple[float, ...], factor: float) -> tuple[float, ...]:
    """A vector times a number."""
    return tuple(factor * x for x in vector)
