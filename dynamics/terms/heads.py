"""Whole models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from dynamics.activations import TANH
from dynamics.terms.kinetic import Fixed
from dynamics.terms.ports import Drag
from dynamics.terms.potentials import Displacement, summed
from dynamics.terms.term import TERMS, HeadTerm, KineticTerm, PortTerm, PotentialTerm, Sizes
from registry import unknown

if TYPE_CHECKING:
    from dynamics import generalised, hamiltonian
    from dynamics.head import Head
    from dynamics.integrators import Integrator


@TERMS.register("hamiltonian")
@dataclass(frozen=True)
class Hamiltonian(HeadTerm):
    """H = T + V: which energies, how they are stepped, and where energy enters or leaves.

    Args:
        kinetic: T.
        potentials: whose sum is V, at least one.
        ports: in the order in which they act.
        integrator: of :data:`dynamics.INTEGRATORS`.
        box: side of a periodic box in world units, or ``None`` for open space.

    Raises:
        TypeError: a part of another kind.
        ValueError: no potential.

    Example:
        Gravity near the ground, with two unit masses that attract each other and air about them:

        >>> from dynamics import build, terms
        >>> falling = terms.Hamiltonian(
        ...     potentials=(terms.Radial(width=16), terms.Uniform()),
        ...     ports=(terms.Drag("square", "positive"),),
        ... )
        >>> head = build(falling, bodies=2, dt=0.01)
        >>> [type(part).__name__ for part in head.potential.parts]
        ['RadialPotential', 'UniformField']
    """

    kinetic: KineticTerm = Fixed()
    potentials: tuple[PotentialTerm, ...] = (Displacement(),)
    ports: tuple[PortTerm, ...] = ()
    integrator: str = "leapfrog"
    box: float | None = None

    def __post_init__(self) -> None:
        _each("Hamiltonian: kinetic", (self.kinetic,), KineticTerm)
        _each("Hamiltonian: potentials", self.potentials, PotentialTerm)
        _each("Hamiltonian: ports", self.ports, PortTerm)
        if not self.potentials:
            raise ValueError("Hamiltonian: potentials is empty; use NoPotential() for no force")

    def build(self, sizes: Sizes) -> hamiltonian.Hamiltonian:
        from dynamics import hamiltonian

        sizes = replace(sizes, box=self.box)
        return hamiltonian.Hamiltonian(
            self.kinetic.build(sizes),
            summed(self.potentials, sizes),
            _integrator(self.integrator),
            [port.build(sizes) for port in self.ports],
        )

    def counted_in(self, length: float, seconds: float) -> Hamiltonian:
        box = None if self.box is None else self.box / length
        return replace(super().counted_in(length, seconds), box=box)


def _each(what: str, parts: object, kind: type) -> None:
    if not isinstance(parts, tuple):
        raise TypeError(f"{what} is a tuple of terms, got {parts!r}")
    for part in parts:
        if not isinstance(part, kind):
            raise TypeError(f"{what}: {part!r} is no {kind.__name__}")


def _integrator(name: str) -> Integrator:
    from dynamics.integrators import INTEGRATORS

    if name not in INTEGRATORS:
        raise unknown("integrator", name, INTEGRATORS)
    return INTEGRATORS[name]


@TERMS.register("walled")
@dataclass(frozen=True)
class Walled(HeadTerm):
    """A Hamiltonian model beside a known wall.

    Args:
        free: the model without the wall.
        place: along the normal, world units.
        restitution: speed across the wall after a bounce over that before it, in [0, 1].
        normal: towards the wall, ``(d,)``.
    """

    free: Hamiltonian
    place: float
    restitution: float
    normal: tuple[float, ...]

    def build(self, sizes: Sizes) -> Head:
        from dynamics import walls

        if len(self.normal) != sizes.space:
            raise ValueError(
                f"Walled: normal must have {sizes.space} numbers, one of each dimension of space, "
                f"got {self.normal}"
            )
        wall = walls.Wall(self.place, self.restitution, self.normal)
        return walls.Walled(self.free.build(sizes), wall)

    def counted_in(self, length: float, seconds: float) -> Walled:
        return replace(super().counted_in(length, seconds), place=self.place / length)


@TERMS.register("hard-disks")
@dataclass(frozen=True)
class HardDisks(HeadTerm):
    """Hard disks on a torus of side ``box``, moved from collision to collision."""

    box: float = 4.0

    def build(self, sizes: Sizes) -> Head:
        from dynamics import events

        # Learning approaches the diameter from above, where every collision that was seen can be.
        return events.HardDisks(self.box, 0.4 * self.box, learned=True)

    def counted_in(self, length: float, seconds: float) -> HardDisks:
        return replace(self, box=self.box / length)


@dataclass(frozen=True)
class Generalised(HeadTerm):
    """Joints with a learned metric M(q) and potential, in one of two formalisms.

    Args:
        metric: what is learned by its Cholesky factor: the ``mass`` matrix or its ``inverse``.
        factored: V = G U(q); otherwise one network of q and all parameters.
        width, activation: of the networks.
        integrator: of :data:`dynamics.INTEGRATORS`, for a field that is not separable.
        ports: joint friction.
    """

    made: ClassVar[str]  # in :mod:`dynamics.generalised`
    metric: str = "mass"
    factored: bool = True
    width: int = 64
    activation: str = TANH
    integrator: str = "tao"
    ports: tuple[Drag, ...] = ()

    def __post_init__(self) -> None:
        _each(f"{type(self).__name__}: ports", self.ports, Drag)

    def build(self, sizes: Sizes) -> generalised.Generalised:
        from dynamics import generalised
        from dynamics.angles import AnglePotential
        from dynamics.metric import CholeskyMetric

        joints, network = sizes.coordinates, (self.width, self.activation)
        made: type[generalised.Generalised] = getattr(generalised, self.made)
        return made(
            CholeskyMetric(joints, *network, self.metric),
            AnglePotential(joints, 0 if self.factored else sizes.conditions, *network),
            _integrator(self.integrator),
            sizes.dt,
            [port.build(sizes) for port in self.ports],
        )


@TERMS.register("generalised-hamiltonian")
@dataclass(frozen=True)
class GeneralisedHamiltonian(Generalised):
    """By Hamilton's equations (generalised HNN; SymODEN with the ``inverse`` metric)."""

    made = "GeneralisedHamiltonian"


@TERMS.register("lagrangian")
@dataclass(frozen=True)
class Lagrangian(Generalised):
    """By the Euler-Lagrange equations, stepped in (q, dq/dt) (DeLaN)."""

    made = "Lagrangian"


@TERMS.register("residual")
@dataclass(frozen=True)
class Residual(HeadTerm):
    """A transition map without structure; ``angles`` tells it that positions are joint angles."""

    width: int = 256
    angles: bool = False

    def build(self, sizes: Sizes) -> Head:
        from dynamics import unstructured

        size = sizes.bodies, sizes.space, sizes.conditions
        return unstructured.ResidualMap(*size, self.width, sizes.dt, self.angles)


@TERMS.register("flow")
@dataclass(frozen=True)
class Flow(HeadTerm):
    """A vector field without structure (a neural ODE)."""

    width: int = 256

    def build(self, sizes: Sizes) -> Head:
        from dynamics import unstructured

        size = sizes.bodies, sizes.space, sizes.conditions
        return unstructured.NeuralODE(*size, self.width, sizes.dt)


@TERMS.register("diffusion")
@dataclass(frozen=True)
class Diffusion(HeadTerm):
    """A drift and a diffusion without structure (a neural SDE)."""

    width: int = 128

    def build(self, sizes: Sizes) -> Head:
        from dynamics import stochastic

        size = sizes.bodies, sizes.space, sizes.conditions
        return stochastic.NeuralSDE(*size, self.width, sizes.dt)


@TERMS.register("graph")
@dataclass(frozen=True)
class Graph(HeadTerm):
    """A graph network; a factored one multiplies the summed messages by G."""

    width: int = 128
    factored: bool = False

    def build(self, sizes: Sizes) -> Head:
        from dynamics import graph

        return graph.GraphNetwork(sizes.space, self.width, self.factored, sizes.dt)


@TERMS.register("attention")
@dataclass(frozen=True)
class Attention(HeadTerm):
    """A set transformer."""

    width: int = 96

    def build(self, sizes: Sizes) -> Head:
        from dynamics import attention

        return attention.SetTransformer(sizes.space, self.width, sizes.dt)
