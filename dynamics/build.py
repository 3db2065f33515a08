"""From the terms that a scene has to the model that has exactly those."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from dynamics.angles import AnglePotential
from dynamics.attention import SetTransformer
from dynamics.bath import BATHS
from dynamics.contact import FreeImpulse, KnotPotential, Restitution
from dynamics.coupling_maps import GAIN, MAPS, MappedPotential
from dynamics.couplings import PairLaw
from dynamics.events import HardDisks
from dynamics.fields import UniformField
from dynamics.friction import FRICTIONS, Friction
from dynamics.generalised import GeneralisedHamiltonian, Lagrangian
from dynamics.graph import GraphNetwork
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head
from dynamics.hybrid import Shortcut
from dynamics.integrators import INTEGRATORS
from dynamics.kinetic import BodyKinetic, FixedKinetic, FreeKinetic, Kinetic
from dynamics.metric import CholeskyMetric
from dynamics.ports import LinearFriction, Port
from dynamics.potentials import (
    DisplacementPotential,
    FreePotential,
    HarmonicTrap,
    NoPotential,
    Potential,
    RadialPotential,
    SumPotential,
)
from dynamics.stochastic import NeuralSDE
from dynamics.terms import (
    AttentionTerms,
    DiffusionTerms,
    FlowTerms,
    GeneralisedTerms,
    GraphTerms,
    HamiltonianTerms,
    HardDiskTerms,
    ResidualTerms,
    Terms,
    pick,
)
from dynamics.triples import LearnedTriple
from dynamics.unstructured import NeuralODE, ResidualMap
from dynamics.walls import Wall, Walled


@dataclass(frozen=True)
class Sizes:
    """What a model must know of its scene's sizes; see :func:`build`."""

    bodies: int
    space: int
    conditions: int
    dt: float
    box: float | None = None

    @property
    def coordinates(self) -> int:
        """Entries of q."""
        return self.bodies * self.space


def _bath(made: Callable[[int, int], Port], sizes: Sizes) -> Port:
    return made(sizes.bodies, sizes.space)


def _friction(name: str, sizes: Sizes) -> Friction:
    return Friction(*FRICTIONS[name])


PORTS: dict[str, Callable[[Sizes], Port]] = {
    "linear-friction": lambda sizes: LinearFriction(),
    **{name: partial(_friction, name) for name in FRICTIONS},
    "restitution": lambda sizes: Restitution(sizes.box),
    "free-impulse": lambda sizes: FreeImpulse(sizes.box),
    **{name: partial(_bath, made) for name, made in BATHS.items()},
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
    return pick("kind of terms", BUILDERS, type(terms))(terms, sizes)


def _hard_disks(terms: HardDiskTerms, sizes: Sizes) -> Head:
    # Learning approaches the diameter from above, where every collision that was seen can be.
    return HardDisks(terms.box, 0.4 * terms.box, learned=True)


def _residual(terms: ResidualTerms, sizes: Sizes) -> Head:
    size = sizes.bodies, sizes.space, sizes.conditions
    return ResidualMap(*size, terms.width, sizes.dt, terms.angles)


def _generalised(terms: GeneralisedTerms, sizes: Sizes) -> Head:
    joints, network = sizes.coordinates, (terms.width, terms.activation)
    formalisms = {"hamiltonian": GeneralisedHamiltonian, "lagrangian": Lagrangian}
    return pick("formalism", formalisms, terms.formalism)(
        CholeskyMetric(joints, *network, terms.metric),
        AnglePotential(joints, 0 if terms.factored else sizes.conditions, *network),
        pick("integrator", INTEGRATORS, terms.integrator),
        sizes.dt,
        [Friction(*pick("joint friction", FRICTIONS, name)) for name in terms.ports],
    )


def _flow(terms: FlowTerms, sizes: Sizes) -> Head:
    return NeuralODE(sizes.bodies, sizes.space, sizes.conditions, terms.width, sizes.dt)


def _diffusion(terms: DiffusionTerms, sizes: Sizes) -> Head:
    return NeuralSDE(sizes.bodies, sizes.space, sizes.conditions, terms.width, sizes.dt)


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
    sizes = replace(sizes, box=terms.box)
    head = Hamiltonian(
        pick("kinetic energy", kinetics, terms.kinetic)(),
        _potential(terms, sizes),
        pick("integrator", INTEGRATORS, terms.integrator),
        [pick("port", PORTS, name)(sizes) for name in terms.ports],
    )
    return Walled(head, _wall(terms.wall, sizes.space)) if terms.wall else head


def _wall(numbers: tuple[float, ...], space: int) -> Wall:
    if len(numbers) != 2 + space:
        raise ValueError(
            f"build: a wall in {space} dimensions is its place, restitution and {space} numbers of "
            f"its normal, got {numbers}"
        )
    place, restitution, *normal = numbers
    return Wall(place, restitution, normal)


def _potential(terms: HamiltonianTerms, sizes: Sizes) -> Potential:
    pairs: dict[str, Callable[[PairLaw], Potential]] = {
        "displacement": lambda law: DisplacementPotential(
            sizes.space, terms.width, terms.activation, law
        ),
        "radial": lambda law: RadialPotential(terms.width, terms.activation, law),
        "knots": lambda law: KnotPotential(terms.width, terms.reach, law),
    }
    parts: list[Potential]
    if terms.potential == "free":
        parts = [FreePotential(sizes.coordinates, sizes.conditions, terms.width, terms.activation)]
    elif terms.potential in (*MAPS, GAIN):
        size, map_name = (sizes.coordinates, terms.width, terms.activation), terms.potential
        parts = [MappedPotential(*size, map_name)]
    elif terms.potential == "none":
        parts = [NoPotential()]
    else:
        pair = pick("potential energy", pairs, terms.potential)
        parts = [pair(PairLaw(source, terms.coupling, terms.box)) for source in terms.sources]
    if terms.triples:
        parts.append(LearnedTriple(terms.width, terms.activation, terms.coupling))
    if terms.uniform:
        parts.append(UniformField(sizes.space))
    if terms.trap is not None:
        parts.append(HarmonicTrap(terms.trap))
    whole = parts[0] if len(parts) == 1 else SumPotential(parts)
    if terms.shortcut:
        return Shortcut(whole, sizes.space, terms.width, terms.box)
    return whole


# One line for each family of models.
BUILDERS: dict[type, Callable[[Any, Sizes], Head]] = {
    HamiltonianTerms: _hamiltonian,
    HardDiskTerms: _hard_disks,
    GeneralisedTerms: _generalised,
    ResidualTerms: _residual,
    FlowTerms: _flow,
    DiffusionTerms: _diffusion,
    GraphTerms: _graph,
    AttentionTerms: _attention,
}


def parameter_count(head: Head) -> int:
    """Number of learned scalars."""
    return sum(p.numel() for p in head.parameters())
