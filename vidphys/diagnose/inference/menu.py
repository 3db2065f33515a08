"""The menu of terms: which accelerations a scene may have, as columns of a linear regression.

Signs are such that a positive coefficient is what the term's name says: attraction, a restoring
trap, a resistance. One term of each family at most stands in a structure; two that occur together
are a term of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vidphys.diagnose.weak.paths import Paths
from vidphys.diagnose.weak.windows import Windows

PAIR, EXTERNAL, FRICTION = "pair", "external", "friction"
FAMILIES = (PAIR, EXTERNAL, FRICTION)
STILL = 1e-9  # of the largest speed, below which a direction of motion means nothing


@dataclass(frozen=True)
class Field:
    """Where columns are evaluated.

    Args:
        q, v: ``(w, m, n, d)``.
        t: clip time, ``(w, m)``.
        mass: ``(w, n)``.
        strength: what multiplies forces of pairs, ``(w,)``.
    """

    q: np.ndarray
    v: np.ndarray
    t: np.ndarray
    mass: np.ndarray
    strength: np.ndarray

    @cached_property
    def apart(self) -> np.ndarray:
        """From each body to each other, ``(w, m, n, n, d)``."""
        return self.q[:, :, None, :, :] - self.q[:, :, :, None, :]

    @cached_property
    def distance(self) -> np.ndarray:
        """``(w, m, n, n)``; infinite from a body to itself."""
        squared = (self.apart**2).sum(-1)
        own = np.eye(self.q.shape[2], dtype=bool)
        return np.where(own, np.inf, np.sqrt(squared))

    @property
    def inertia(self) -> np.ndarray:
        """Masses beside columns, ``(w, 1, n, 1, 1)``."""
        return self.mass[:, None, :, None, None]


def field_of(windows: Windows, paths: Paths, strength: np.ndarray | None = None) -> Field:
    """The field along paths through windows; pair forces scale with the coupling if one is known.

    Args:
        windows: give times and masses.
        paths: give places and velocities.
        strength: ``(w,)`` in place of the coupling.
    """
    known = np.ones(len(windows)) if windows.coupling is None else windows.coupling
    return Field(
        paths.q,
        paths.v,
        windows.node_times,
        windows.mass,
        known if strength is None else strength,
    )


@dataclass(frozen=True)
class Term:
    """One entry of the menu.

    Args:
        name: for people and for the report.
        family: at most one of each stands in a structure.
        kind: name without its scale, by which structures are compared.
        coefficients: names of the numbers that it has.
        columns: accelerations ``(w, m, n, d, p)``.
        scale: length in the shape of a pair force, world units.
        shape: of :data:`SHAPES`, or ``rest-length``, of a pair force.
        source: what a pair force goes with: ``mass``, or ``alike`` for all bodies.
        positive: how many of the first coefficients must be positive to mean what the name says.
        parts: two terms of one family that stand together, one for each coefficient.
        remade: the same with another length.
        apart: each body has a number of its own.
    """

    name: str
    family: str
    kind: str
    coefficients: tuple[str, ...]
    columns: Callable[[Field], np.ndarray]
    scale: float | None = None
    positive: int = 0
    shape: str = ""
    source: str = ""
    parts: tuple[Term, ...] = ()
    remade: Callable[[float], Term] | None = None
    apart: bool = False

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kind, or those of two terms of one family."""
        return tuple(part.kind for part in self.parts) or (self.kind,)

    @property
    def named(self) -> list[str]:
        """The kind that each coefficient belongs to, and its name."""
        of = self.kinds if self.parts else self.kinds * len(self.coefficients)
        return [f"{kind}: {name}" for kind, name in zip(of, self.coefficients, strict=True)]

    @property
    def shapes(self) -> tuple[str, ...]:
        """The shape that each coefficient of a pair force belongs to."""
        shapes, _ = TWO_SHAPES.get(self.shape, (tuple(self.shape.split("+")), ()))
        return shapes

    @property
    def size(self) -> int:
        """Numbers that are fitted, lengths among them."""
        lengths = [term.scale for term in self.parts or (self,)]
        return len(self.coefficients) + sum(length is not None for length in lengths)


def axes(field: Field) -> np.ndarray:
    """A constant acceleration along each axis."""
    space = field.q.shape[-1]
    return np.broadcast_to(np.eye(space), (*field.q.shape, space))


def trap(field: Field) -> np.ndarray:
    """Restoring towards a centre: -q / m, and what moves the centre from the origin."""
    pull = -field.q[..., None] / field.inertia
    return np.concatenate([pull, axes(field) / field.inertia], -1)


def swing(field: Field) -> np.ndarray:
    """A pendulum whose coordinate is its angle in radians, hanging at zero or nearly."""
    angle = field.q[..., None] / 1.0
    return np.concatenate([-np.sin(angle), np.cos(angle)], -1)


def well(field: Field) -> np.ndarray:
    """A force that is a cubic in the one coordinate: a trap whose sides differ."""
    q = field.q[..., None]
    return np.concatenate([-q, np.ones_like(q), q**2, -(q**3)], -1) / field.inertia


def resistance(power: int) -> Callable[[Field], np.ndarray]:
    """-|v|^(power - 1) v / m: dry for power 0, linear for 1, square for 2."""

    def columns(field: Field) -> np.ndarray:
        speed = np.linalg.norm(field.v, axis=-1, keepdims=True)
        least = max(STILL * float(speed.max(initial=0.0)), np.finfo(float).tiny)
        size = np.maximum(speed, least) ** (power - 1)
        return -(size * field.v)[..., None] / field.inertia

    return columns


def _inverse(r: np.ndarray) -> np.ndarray:
    """1 / r; zero where bodies coincide, because there a force has no direction."""
    return 1 / np.where(r > 0, r, np.inf)


SHAPES: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "inverse-square": lambda r, s: (r**2 + s**2) ** -1.5,
    "point": lambda r, s: _inverse(r) ** 3,  # the same, where no length is seen to soften it
    "inverse": lambda r, s: 1 / (r**2 + s**2),
    "gaussian": lambda r, s: np.exp(-0.5 * (r / s) ** 2),
    "spring": lambda r, s: np.isfinite(r).astype(float),
    "rest-length": lambda r, s: _inverse(r),
    "inverse-cube": lambda r, s: (r**2 + s**2) ** -2.0,
    "cut-off": lambda r, s: np.maximum(1 - (r / s) ** 2, 0) ** 2,
    "contact": lambda r, s: -np.maximum(s * _inverse(r) - 1, 0),
    "twelve": lambda r, s: -(_inverse(r) ** 14),
    "six": lambda r, s: _inverse(r) ** 8,
    # powers between whole ones, which are asked as rivals and never told
    "power 1/2": lambda r, s: (r**2 + s**2) ** -0.75,
    "power 3/2": lambda r, s: (r**2 + s**2) ** -1.25,
    "power 5/2": lambda r, s: (r**2 + s**2) ** -1.75,
}
"""Pair force over the displacement, from the distance and a length; infinite distance gives 0."""


POWERS = frozenset({"inverse", "inverse-square", "point", "inverse-cube"})  # whole ones
BETWEEN = ("power 1/2", "power 3/2", "power 5/2")


TWO_SHAPES: dict[
    str, tuple[tuple[str, ...], tuple[str, ...]]
] = {  # pair forces of two numbers: their shapes, and what the numbers are called
    "rest-length": (("spring", "rest-length"), ("stiffness", "offset")),
    # of an energy (repulsion / 12) / r^12 - (attraction / 6) / r^6 (Jones 1924)
    "lennard-jones": (("twelve", "six"), ("repulsion", "attraction")),
}

POSITIVE = {"contact": 1, "cut-off": 1, "lennard-jones": 2}  # a repulsion that ends is a contact


def attraction(shapes: tuple[str, ...], scale: float, source: str) -> Callable[[Field], np.ndarray]:
    """Acceleration towards the other bodies, a column for each shape."""

    def columns(field: Field) -> np.ndarray:
        pull = [_summed(field, SHAPES[shape](field.distance, scale), source) for shape in shapes]
        return np.stack(pull, -1) * field.strength[:, None, None, None, None]

    return columns


def _summed(field: Field, shape: np.ndarray, source: str) -> np.ndarray:
    if source == "mass":
        shape = shape * field.mass[:, None, None, :]
    else:
        shape = shape / field.mass[:, None, :, None]
    return (shape[..., None, :] @ field.apart)[..., 0, :]


FRICTIONS = {
    "linear": Term("linear friction", FRICTION, "linear", ("rate",), resistance(1)),
    "square": Term("v^2 friction", FRICTION, "square", ("rate",), resistance(2), positive=1),
    "dry": Term("dry friction", FRICTION, "dry", ("rate",), resistance(0), positive=1),
}


def together(first: Term, second: Term) -> Term:
    """Two terms of one family, of one coefficient each, as one; its length is the second's."""

    def columns(field: Field) -> np.ndarray:
        return np.concatenate([first.columns(field), second.columns(field)], -1)

    remade = second.remade
    return Term(
        f"{first.name} and {second.name}",
        first.family,
        f"{first.kind}+{second.kind}",
        (*first.coefficients, *second.coefficients),
        columns,
        second.scale,
        positive=2,
        shape=f"{first.shape}+{second.shape}",
        source=first.source,
        parts=(first, second),
        remade=None if remade is None else lambda scale: together(first, remade(scale)),
    )


TWO_FRICTIONS = tuple(together(FRICTIONS["linear"], FRICTIONS[x]) for x in ("square", "dry"))


def of_each_body(friction: Term, bodies: int) -> Term:
    """A friction of the same law with a rate of its own for each body."""

    def columns(field: Field) -> np.ndarray:
        return friction.columns(field) * np.eye(bodies)[:, None, :]

    return replace(
        friction,
        name=f"{friction.name} of each body",
        coefficients=tuple(f"rate {body}" for body in range(1, bodies + 1)),
        columns=columns,
        apart=True,
    )


SOFTENINGS = (0.03, 0.06, 0.12, 0.2, 0.3, 0.45, 0.7)  # over the median distance
WIDTHS = (0.2, 0.4, 0.7, 1.1)
CONTACTS = (1.1, 1.25, 1.45, 1.7, 2.0, 2.4, 3.0)  # over the least distance
REACHES = (0.6, 0.85, 1.15, 1.5, 2.0)  # over the median distance, of forces that end
NEARBY = (0.75, 0.85, 0.93, 1.0, 1.07, 1.17, 1.33)  # over the best length so far


def pair_term(kind: str, scale: float | None, source: str) -> Term:
    """The term of one pair force."""
    shapes, names = TWO_SHAPES.get(kind, ((kind,), ("strength",)))
    group = "contact" if kind == "contact" else "pair"
    length = "" if scale is None else f", length {scale:.3g}"
    return Term(
        f"{kind} pair force{length}",
        PAIR,
        group,
        names,
        attraction(shapes, scale or 1.0, source),
        scale,
        positive=POSITIVE.get(kind, 0),
        shape=kind,
        source=source,
        remade=None if scale is None else lambda other: pair_term(kind, other, source),
    )


def pair_terms(distance: np.ndarray, source: str, near: Sequence[Term] = ()) -> list[Term]:
    """Pair forces to try, their lengths taken from the distances that occur.

    Args:
        distance: between bodies, any shape.
        source: ``mass`` where forces go with both masses, else ``alike``.
        near: the best of some shapes so far, about which lengths lie closer.
    """
    finite = distance[np.isfinite(distance)]
    usual, least = float(np.median(finite)), float(np.quantile(finite, 0.005))
    scales: dict[str, list[float | None]] = {
        "inverse-square": [usual * x for x in SOFTENINGS],
        "inverse": [usual * x for x in SOFTENINGS[::2]],
        "inverse-cube": [usual * x for x in SOFTENINGS[::2]],
        "cut-off": [usual * x for x in REACHES],
        "gaussian": [usual * x for x in WIDTHS],
        "contact": [least * x for x in CONTACTS],
        "point": [None],
        "lennard-jones": [None],
        "spring": [None],
        "rest-length": [None],
    }
    close = {term.shape: term for term in near if term.scale is not None}
    for shape, term in close.items():
        if shape in scales and term.scale is not None:
            scales[shape] = [term.scale * x for x in NEARBY]
    terms = [pair_term(kind, scale, source) for kind, some in scales.items() for scale in some]
    both = next((term for term in close.values() if term.parts), None)
    if both is not None and both.remade is not None and both.scale is not None:
        return terms + [both.remade(both.scale * x) for x in NEARBY]
    soft = [pair_term("inverse-square", usual * x, source) for x in SOFTENINGS[1::3]]
    hard = [pair_term("contact", least * x, "alike") for x in CONTACTS[1::2]]
    return terms + [together(pull, push) for pull in soft for push in hard]


def external_terms(space: int, angles: bool) -> list[Term]:
    """External forces: a uniform field, a trap about any centre, and what an angle hangs in."""
    names = ("x", "y", "z")[:space]
    uniform = Term("uniform field", EXTERNAL, "uniform", names, axes)
    held = ("stiffness", *(f"centre pull {x}" for x in names))
    terms = [uniform, Term("trap", EXTERNAL, "trap", held, trap, positive=1)]
    if space == 1 and not angles:
        terms.append(Term("well", EXTERNAL, "well", ("stiffness", "push", "second", "third"), well))
    if angles:
        terms.append(Term("pendulum", EXTERNAL, "pendulum", ("hanging", "aside"), swing))
    return terms
