"""The terms that a model may have: what it is made of, as data; and the study's heads by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, TypeVar

from dynamics.mlp import TANH

T = TypeVar("T")


@dataclass(frozen=True)
class HamiltonianTerms:
    """H = T + V: which energies, how they are stepped, and where energy enters or leaves.

    Args:
        kinetic: ``fixed`` (|p|^2 / 2m), ``body`` (one learned function of each body) or ``free``.
        potential: of each pair, ``displacement``, ``radial`` or ``knots`` (a force of finite
            range, linear between learned distances); ``none``; of all positions, ``linear``,
            ``localised`` or ``gain`` in the coupling (:mod:`dynamics.coupling_maps`); ``free``
            imposes nothing.
        sources: what the pair laws act on, see :class:`dynamics.couplings.PairLaw`; one learned
            pair function for each.
        coupling: how the strength enters a pair law: ``linear``, ``even``, ``quadratic`` or
            ``cubic``.
        box: side of a periodic box in world units, or ``None``.
        reach: world units; distance up to which knots are spread at first.
        shortcut: whether a free force between pairs stands beside the potential.
        trap: stiffness of a known harmonic confinement, or ``None``.
        uniform: whether a learned uniform field acts on every body.
        wall: place, restitution and outward normal of a known wall; nothing where there is none.
        width, activation: of the networks.
        integrator: of :data:`dynamics.INTEGRATORS`.
        ports: of :data:`PORTS`, in the order in which they act.
        triples: whether a learned function of each three bodies stands beside the pairs.
    """

    kinetic: Literal["fixed", "body", "free"] = "fixed"
    potential: Literal[
        "displacement", "radial", "knots", "linear", "localised", "gain", "free", "none"
    ] = "displacement"
    sources: tuple[str, ...] = ("mass",)
    coupling: str = "linear"
    box: float | None = None
    reach: float = 1.0
    shortcut: bool = False
    trap: float | None = None
    uniform: bool = False
    wall: tuple[float, ...] = ()
    width: int = 64
    activation: str = TANH
    integrator: str = "leapfrog"
    ports: tuple[str, ...] = ()
    triples: bool = False


@dataclass(frozen=True)
class HardDiskTerms:
    """Hard disks on a torus of side ``box``, moved from collision to collision."""

    box: float = 4.0


@dataclass(frozen=True)
class ResidualTerms:
    """A transition map without structure; ``angles`` tells it that positions are joint angles."""

    width: int = 256
    angles: bool = False


@dataclass(frozen=True)
class GeneralisedTerms:
    """Joints with a learned metric M(q) and potential.

    Args:
        formalism: ``hamiltonian`` or ``lagrangian`` (DeLaN, stepped in (q, dq/dt)).
        metric: what is learned by its Cholesky factor: the ``mass`` matrix or its ``inverse``.
        factored: V = G U(q); otherwise one network of q and all parameters.
        width, activation: of the networks.
        integrator: of :data:`dynamics.INTEGRATORS`, for a field that is not separable.
        ports: friction of :data:`PORTS`.
    """

    formalism: Literal["hamiltonian", "lagrangian"] = "hamiltonian"
    metric: Literal["mass", "inverse"] = "mass"
    factored: bool = True
    width: int = 64
    activation: str = TANH
    integrator: str = "tao"
    ports: tuple[str, ...] = ()


@dataclass(frozen=True)
class FlowTerms:
    """A vector field without structure (a neural ODE)."""

    width: int = 256


@dataclass(frozen=True)
class DiffusionTerms:
    """A drift and a diffusion without structure (a neural SDE)."""

    width: int = 128


@dataclass(frozen=True)
class GraphTerms:
    """A graph network; a factored one multiplies the summed messages by G."""

    width: int = 128
    factored: bool = False


@dataclass(frozen=True)
class AttentionTerms:
    """A set transformer."""

    width: int = 96


Terms = (
    HamiltonianTerms
    | GeneralisedTerms
    | HardDiskTerms
    | ResidualTerms
    | FlowTerms
    | DiffusionTerms
    | GraphTerms
    | AttentionTerms
)

HEADS: dict[str, Terms] = {
    "factored": HamiltonianTerms(),
    "factored-radial": HamiltonianTerms(potential="radial"),
    "factored-learned-kinetic": HamiltonianTerms(kinetic="body"),
    "symplectic": HamiltonianTerms(kinetic="free", potential="free", width=256),
    "unstructured": ResidualTerms(),
    "neural-ode": FlowTerms(),
    "gns": GraphTerms(),
    "factored-gns": GraphTerms(factored=True),
    "set-transformer": AttentionTerms(),
}

KINDS = {
    "hamiltonian": HamiltonianTerms,
    "hard-disks": HardDiskTerms,
    "generalised": GeneralisedTerms,
    "residual": ResidualTerms,
    "flow": FlowTerms,
    "diffusion": DiffusionTerms,
    "graph": GraphTerms,
    "attention": AttentionTerms,
}


def pick(what: str, known: Mapping[Any, T], name: Any) -> T:
    """The entry of this name.

    Raises:
        ValueError: there is none; the known ones are named.
    """
    if name not in known:
        raise ValueError(f"dynamics: unknown {what} '{name}'; known: {', '.join(map(str, known))}")
    return known[name]


def to_config(terms: Terms) -> dict[str, Any]:
    """Plain data from which :func:`from_config` rebuilds the terms."""
    kind = next(name for name, kind in KINDS.items() if kind is type(terms))
    return {"kind": kind, **asdict(terms)}


def from_config(config: dict[str, Any]) -> Terms:
    """Inverse of :func:`to_config`, also after a way through JSON.

    Raises:
        ValueError: an unknown kind or key.
    """
    values = dict(config)
    kind = pick("kind of terms", KINDS, values.pop("kind", ""))
    known = {field.name: field for field in fields(kind)}
    for key, value in values.items():
        pick(f"key of {kind.__name__}", known, key)
        values[key] = tuple(value) if isinstance(value, list) else value
    return kind(**values)
