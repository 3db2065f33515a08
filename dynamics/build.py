"""From the terms that a scene has to the model that has exactly those."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from dynamics.hamiltonian import Hamiltonian
from dynamics.integrators import INTEGRATORS
from dynamics.kinetic import BodyKinetic, FixedKinetic, FreeKinetic
from dynamics.mlp import TANH
from dynamics.potentials import DisplacementPotential, FreePotential, RadialPotential
from dynamics.unstructured import ResidualMap

Head = Hamiltonian | ResidualMap


@dataclass(frozen=True)
class HamiltonianTerms:
    """H = T + V: which kinetic and which potential energy, and how it is stepped."""

    kinetic: Literal["fixed", "body", "free"] = "fixed"
    potential: Literal["displacement", "radial", "free"] = "displacement"
    width: int = 64
    activation: str = TANH
    integrator: str = "leapfrog"


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
    """
    if bodies < 1:
        raise ValueError(f"build: a model needs at least one body, got bodies = {bodies}")
    if isinstance(terms, ResidualTerms):
        return ResidualMap(bodies, space, terms.width, dt)
    kinetics = {
        "fixed": lambda: FixedKinetic(),
        "body": lambda: BodyKinetic(space, terms.width, terms.activation),
        "free": lambda: FreeKinetic(bodies, space, terms.width, terms.activation),
    }
    potentials = {
        "displacement": lambda: DisplacementPotential(space, terms.width, terms.activation),
        "radial": lambda: RadialPotential(terms.width, terms.activation),
        "free": lambda: FreePotential(bodies, space, terms.width, terms.activation),
    }
    return Hamiltonian(
        kinetics[terms.kinetic](), potentials[terms.potential](), INTEGRATORS[terms.integrator]
    )


def to_config(terms: Terms) -> dict[str, Any]:
    """Plain data from which :func:`from_config` rebuilds the terms."""
    kind = "residual" if isinstance(terms, ResidualTerms) else "hamiltonian"
    return {"kind": kind, **asdict(terms)}


def from_config(config: dict[str, Any]) -> Terms:
    """Inverse of :func:`to_config`; an unknown kind or key is an error."""
    fields = dict(config)
    kinds = {"residual": ResidualTerms, "hamiltonian": HamiltonianTerms}
    kind = fields.pop("kind", None)
    if kind not in kinds:
        raise ValueError(f"dynamics: unknown kind '{kind}' of terms; known: {', '.join(kinds)}")
    return kinds[kind](**fields)


def parameter_count(head: Head) -> int:
    """Number of learned scalars."""
    return sum(p.numel() for p in head.parameters())
