"""From the terms that a scene has to the model that has exactly those."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, TypeVar

from dynamics.hamiltonian import Hamiltonian
from dynamics.integrators import INTEGRATORS
from dynamics.kinetic import BodyKinetic, FixedKinetic, FreeKinetic, Kinetic
from dynamics.mlp import TANH
from dynamics.ports import LinearFriction
from dynamics.potentials import (
    DisplacementPotential,
    FreePotential,
    Potential,
    RadialPotential,
)
from dynamics.unstructured import ResidualMap

T = TypeVar("T")

Head = Hamiltonian | ResidualMap


@dataclass(frozen=True)
class HamiltonianTerms:
    """H = T + V: which energies, how they are stepped, and whether friction takes any."""

    kinetic: Literal["fixed", "body", "free"] = "fixed"
    potential: Literal["displacement", "radial", "free"] = "displacement"
    width: int = 64
    activation: str = TANH
    integrator: str = "leapfrog"
    friction: bool = False


@dataclass(frozen=True)
class ResidualTerms:
    """A transition map without structure."""

    width: int = 256


Terms = HamiltonianTerms | ResidualTerms

HEADS: dict[str, Terms] = {
    "factored": HamiltonianTerms(),
    "factored-radial": HamiltonianTerms(potential="radial"),
    "factored-learned-kinetic": HamiltonianTerms(kinetic="body"),
    "symplectic": HamiltonianTerms(kinetic="free", potential="free", width=256),
    "unstructured": ResidualTerms(),
}


def build(terms: Terms, bodies: int, dt: float, space: int = 2) -> Head:
    """Build the model of these terms, randomly initialised from torch's global generator.

    Args:
        terms: see :data:`HEADS` for the study's, by name.
        bodies: number of bodies N >= 1.
        dt: seconds; what one application of a transition map stands for. A Hamiltonian has a
            vector field and may be stepped by any dt.
        space: dimensions of space.

    Raises:
        ValueError: no bodies, or a name in the terms that is not known.
    """
    if bodies < 1:
        raise ValueError(f"build: a model needs at least one body, got bodies = {bodies}")
    if isinstance(terms, ResidualTerms):
        return ResidualMap(bodies, space, terms.width, dt)
    kinetics: dict[str, Callable[[], Kinetic]] = {
        "fixed": lambda: FixedKinetic(),
        "body": lambda: BodyKinetic(space, terms.width, terms.activation),
        "free": lambda: FreeKinetic(bodies, space, terms.width, terms.activation),
    }
    potentials: dict[str, Callable[[], Potential]] = {
        "displacement": lambda: DisplacementPotential(space, terms.width, terms.activation),
        "radial": lambda: RadialPotential(terms.width, terms.activation),
        "free": lambda: FreePotential(bodies, space, terms.width, terms.activation),
    }
    return Hamiltonian(
        _pick("kinetic energy", kinetics, terms.kinetic)(),
        _pick("potential energy", potentials, terms.potential)(),
        _pick("integrator", INTEGRATORS, terms.integrator),
        LinearFriction() if terms.friction else None,
    )


def _pick(what: str, known: Mapping[str, T], name: str) -> T:
    if name not in known:
        raise ValueError(f"dynamics: unknown {what} '{name}'; known: {', '.join(known)}")
    return known[name]


def to_config(terms: Terms) -> dict[str, Any]:
    """Plain data from which :func:`from_config` rebuilds the terms."""
    kind = "residual" if isinstance(terms, ResidualTerms) else "hamiltonian"
    return {"kind": kind, **asdict(terms)}


def from_config(config: dict[str, Any]) -> Terms:
    """Inverse of :func:`to_config`; an unknown kind or key is an error."""
    values = dict(config)
    kinds: dict[str, type[Terms]] = {"residual": ResidualTerms, "hamiltonian": HamiltonianTerms}
    kind = _pick("kind of terms", kinds, values.pop("kind", ""))
    known = {field.name: field for field in fields(kind)}
    for key in values:
        _pick(f"key of {kind.__name__}", known, key)
    return kind(**values)


def parameter_count(head: Head) -> int:
    """Number of learned scalars."""
    return sum(p.numel() for p in head.parameters())
