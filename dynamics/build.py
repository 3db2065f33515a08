"""From the terms that a scene has to the model that has exactly those."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, TypeVar

from dynamics.attention import SetTransformer
from dynamics.couplings import PairLaw
from dynamics.graph import GraphNetwork
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head
from dynamics.integrators import INTEGRATORS
from dynamics.kinetic import BodyKinetic, FixedKinetic, FreeKinetic, Kinetic
from dynamics.mlp import TANH
from dynamics.ports import LinearFriction, Port
from dynamics.potentials import (
    DisplacementPotential,
    FreePotential,
    HarmonicTrap,
    Potential,
    RadialPotential,
    SumPotential,
)
from dynamics.unstructured import NeuralODE, ResidualMap

T = TypeVar("T")


@dataclass(frozen=True)
class Sizes:
    """What a model must know of its scene's sizes; see :func:`build`."""

    bodies: int
    space: int
    conditions: int
    dt: float

    @property
    def coordinates(self) -> int:
        """Entries of q."""
        return self.bodies * self.space


@dataclass(frozen=True)
class HamiltonianTerms:
    """H = T + V: which energies, how they are stepped, and where energy enters or leaves.

    Args:
        kinetic: ``fixed`` (|p|^2 / 2m), ``body`` (one learned function of each body) or ``free``.
        potential: of each pair, ``displacement`` or ``radial``; ``free`` imposes nothing.
        sources: what the pair laws act on, see :class:`dynamics.couplings.PairLaw`; one learned
            pair function for each.
        coupling: how the strength enters: ``linear``, ``even`` or ``quadratic``.
        box: side of a periodic box in world units, or ``None``.
        trap: stiffness of a known harmonic confinement, or ``None``.
        width, activation: of the networks.
        integrator: of :data:`dynamics.INTEGRATORS`.
        ports: of :data:`PORTS`, in the order in which they act.
    """

    kinetic: Literal["fixed", "body", "free"] = "fixed"
    potential: Literal["displacement", "radial", "free"] = "displacement"
    sources: tuple[str, ...] = ("mass",)
    coupling: str = "linear"
    box: float | None = None
    trap: float | None = None
    width: int = 64
    activation: str = TANH
    integrator: str = "leapfrog"
    ports: tuple[str, ...] = ()


@dataclass(frozen=True)
class ResidualTerms:
    """A transition map without structure."""

    width: int = 256


@dataclass(frozen=True)
class FlowTerms:
    """A vector field without structure (a neural ODE)."""

    width: int = 256


@dataclass(frozen=True)
class GraphTerms:
    """A graph network; a factored one multiplies the summed messages by G."""

    width: int = 128
    factored: bool = False


@dataclass(frozen=True)
class AttentionTerms:
    """A set transformer."""

    width: int = 96


Terms = HamiltonianTerms | ResidualTerms | FlowTerms | GraphTerms | AttentionTerms

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


PORTS: dict[str, Callable[[Sizes], Port]] = {
    "linear-friction": lambda sizes: LinearFriction(),
}


def build(
    terms: Terms, bodies: int, dt: float, space: int = 2, conditions: int | None = None
) -> Head:
    """Build the model of these terms, randomly initialised from torch's global generator.

    Args:
        terms: see :data:`HEADS` for the study's, by name.
        bodies: number of bodies N >= 1.
        dt: seconds; what one application of a transition map stands for. A Hamiltonian has a
            vector field and may be stepped by any dt.
        space: dimensions of space.
        conditions: entries of the parameters' vector, for networks that are given it; G and the
            masses by default.

    Raises:
        ValueError: no bodies, or a name in the terms that is not known.
    """
    if bodies < 1:
        raise ValueError(f"build: a model needs at least one body, got bodies = {bodies}")
    sizes = Sizes(bodies, space, bodies + 1 if conditions is None else conditions, dt)
    return _pick("kind of terms", BUILDERS, type(terms))(terms, sizes)


def _residual(terms: ResidualTerms, sizes: Sizes) -> Head:
    return ResidualMap(sizes.bodies, sizes.space, sizes.conditions, terms.width, sizes.dt)


def _flow(terms: FlowTerms, sizes: Sizes) -> Head:
    return NeuralODE(sizes.bodies, sizes.space, sizes.conditions, terms.width, sizes.dt)


def _graph(terms: GraphTerms, sizes: Sizes) -> Head:
    return GraphNetwork(sizes.space, terms.width, terms.factored, sizes.dt)


def _attention(terms: AttentionTerms, sizes: Sizes) -> Head:
    return SetTransformer(sizes.space, terms.width, sizes.dt)


def _hamiltonian(terms: HamiltonianTerms, sizes: Sizes) -> Head:
    kinetics: dict[str, Callable[[], Kinetic]] = {
        "fixed": lambda: FixedKinetic(),
        "body": lambda: BodyKinetic(sizes.space, terms.width, terms.activation),
        "free": lambda: FreeKinetic(
            sizes.coordinates, sizes.conditions, terms.width, terms.activation
        ),
    }
    return Hamiltonian(
        _pick("kinetic energy", kinetics, terms.kinetic)(),
        _potential(terms, sizes),
        _pick("integrator", INTEGRATORS, terms.integrator),
        [_pick("port", PORTS, name)(sizes) for name in terms.ports],
    )


def _potential(terms: HamiltonianTerms, sizes: Sizes) -> Potential:
    pairs: dict[str, Callable[[PairLaw], Potential]] = {
        "displacement": lambda law: DisplacementPotential(
            sizes.space, terms.width, terms.activation, law
        ),
        "radial": lambda law: RadialPotential(terms.width, terms.activation, law),
    }
    parts: list[Potential]
    if terms.potential == "free":
        parts = [FreePotential(sizes.coordinates, sizes.conditions, terms.width, terms.activation)]
    else:
        pair = _pick("potential energy", pairs, terms.potential)
        parts = [pair(PairLaw(source, terms.coupling, terms.box)) for source in terms.sources]
    if terms.trap is not None:
        parts.append(HarmonicTrap(terms.trap))
    return parts[0] if len(parts) == 1 else SumPotential(parts)


# One line for each family of models.
BUILDERS: dict[type, Callable[[Any, Sizes], Head]] = {
    HamiltonianTerms: _hamiltonian,
    ResidualTerms: _residual,
    FlowTerms: _flow,
    GraphTerms: _graph,
    AttentionTerms: _attention,
}
KINDS = {
    "hamiltonian": HamiltonianTerms,
    "residual": ResidualTerms,
    "flow": FlowTerms,
    "graph": GraphTerms,
    "attention": AttentionTerms,
}


def _pick(what: str, known: Mapping[Any, T], name: Any) -> T:
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
    kind = _pick("kind of terms", KINDS, values.pop("kind", ""))
    known = {field.name: field for field in fields(kind)}
    for key, value in values.items():
        _pick(f"key of {kind.__name__}", known, key)
        values[key] = tuple(value) if isinstance(value, list) else value
    return kind(**values)


def parameter_count(head: Head) -> int:
    """Number of learned scalars."""
    return sum(p.numel() for p in head.parameters())
