"""A scene: a law, a generator of episodes, and the float64 truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import torch
from jaxtyping import Bool, Float
from torch import Generator, Tensor

from dynamics import (
    Hamiltonian,
    Head,
    PairLaw,
    Parameters,
    PhaseState,
    Rollout,
    ballistic,
    build,
    rollout,
)
from dynamics.terms import HeadTerm

Sampler = Callable[[int, Generator], tuple[PhaseState, Parameters]]


class Law(Protocol):
    """What a scene's exact law offers; :class:`dynamics.Hamiltonian` does."""

    def energy(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b"]:
        """H of each state, shape of the batch."""

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        """dp/dt of the conservative part, ``(..., n, d)``."""


@dataclass(frozen=True)
class Scene:
    """One system of the study.

    A scene whose truth is not a fixed-step rollout of its law (an engine, an event queue) is a
    subclass with its own :meth:`simulate`.

    Args:
        name: as it stands in the records.
        law: the exact law; it has no learned parts.
        sample: ``(episodes, generator) -> (state, params)`` in float64.
        bodies: number of bodies.
        dt: seconds, the reference step.
        settings: ranges of the generator, for the record.
        space: dimensions of space.
        max_drift: largest energy drift of a reference episode, relative to K + |V| of its start,
            with which it is certified.
        box: side of a periodic box, over which distances are taken; ``None`` for open space.
        least_distance: what two bodies must keep for an episode to be certified; for disks that
            may not overlap.
        half_extent: world units from the middle of its pictures to their edge.
        derivatives_without: what :meth:`derivatives` leaves out because it has no derivative, such
            as a bath's noise; ``None`` where nothing is.
    """

    name: str
    law: Law
    sample: Sampler
    bodies: int
    dt: float
    settings: dict[str, Any] = field(default_factory=dict)
    space: int = 2
    max_drift: float = 0.1
    box: float | None = None
    least_distance: float = 0.0
    half_extent: float = 4.0
    derivatives_without: str | None = None

    @property
    def conserves(self) -> bool:
        """Whether the truth keeps its energy."""
        return getattr(self.law, "conserves", True)

    @property
    def conditions(self) -> int:
        """Entries of the parameters' vector."""
        return self.sample(1, Generator().manual_seed(0))[1].flat.shape[-1]

    def build(self, term: HeadTerm) -> Head:
        """An untrained head of this term for this scene."""
        return build(term, self.bodies, self.dt, self.space, self.conditions)

    def simulate(
        self, start: PhaseState, params: Parameters, steps: int, every: int = 1
    ) -> Rollout:
        """The reference rollout in float64 by the scene's own integrator and step."""
        if not isinstance(self.law, Head):
            raise TypeError(f"scene {self.name}: its law cannot be stepped; override simulate")
        return rollout(
            self.law,
            start.map(torch.Tensor.double),
            params.map(torch.Tensor.double),
            steps,
            self.dt,
            every,
        )

    def straight_lines(
        self, start: PhaseState, params: Parameters, steps: int, every: int
    ) -> Rollout:
        """What the bodies would do without any force, against which skill is measured."""
        return rollout(ballistic(), start, params, steps // every, every * self.dt)

    def place(self, q: Float[Tensor, "*b n d"]) -> Float[Tensor, "*b n e"]:
        """Where bodies are drawn, world units; only what has two coordinates can be.

        It is where they are; in a periodic box, whose middle is drawn in the picture's middle,
        where they come in again.
        """
        return q if self.box is None else q.remainder(self.box) - self.box / 2

    def derivatives(self, states: PhaseState, params: Parameters) -> PhaseState:
        """dq/dt and dp/dt of states by the law, friction and drive among it.

        Args:
            states: ``(..., n, d)``.
            params: of each state.
        """
        if isinstance(self.law, Hamiltonian):
            return self.law.derivatives(states, params)
        velocity = states.p / params.mass.unsqueeze(-1)
        return PhaseState(velocity, self.law.force(states, params))

    def energy(self, states: PhaseState, params: Parameters) -> Float[Tensor, "b t"]:
        """True energy of states ``(b, t, n, d)`` under per-episode parameters, ``(b, t)``."""
        params = params.map(lambda x: x.double().unsqueeze(1))
        return self.law.energy(states.map(torch.Tensor.double), params)

    def energy_scale(self, start: PhaseState, params: Parameters) -> Float[Tensor, " b"]:
        """K + |V| of a start state, ``(b,)``: what an energy near zero is measured against."""
        params = params.map(torch.Tensor.double)
        start = start.map(torch.Tensor.double)
        potential = self.law.energy(PhaseState(start.q, torch.zeros_like(start.p)), params)
        return (self.law.energy(start, params) - potential).abs() + potential.abs()


@dataclass(frozen=True)
class Certificate:
    """What was checked of each generated episode, ``(b,)`` each.

    Args:
        finite: no state is NaN or infinite.
        drift: largest energy drift, relative to K + |V| of the start; NaN where the law is not
            meant to conserve energy.
        closest: smallest distance between two bodies, world units; infinite for a single body.
        in_frame: bodies stay inside the viewport, if one was asked for.
        max_drift: the scene's bound.
        least_distance: the scene's bound.
    """

    finite: Bool[Tensor, " b"]
    drift: Float[Tensor, " b"]
    closest: Float[Tensor, " b"]
    in_frame: Bool[Tensor, " b"]
    max_drift: float
    least_distance: float = 0.0

    @property
    def passed(self) -> Bool[Tensor, " b"]:
        """Finite, in the frame, apart, and the reference is as good as its bound says."""
        sound = self.finite & self.in_frame & (self.closest >= self.least_distance)
        return sound & ~(self.drift >= self.max_drift)


def certify(
    scene: Scene, trajectory: Rollout, half_extent: float | None = None, conserving: bool = True
) -> Certificate:
    """Check a reference rollout.

    Args:
        scene: whose energy is used.
        trajectory: states ``(b, t, n, d)``.
        half_extent: of the viewport in which bodies are drawn, world units; ``None`` asks nothing
            of it.
        conserving: whether energy is meant to be conserved.

    Example:
        >>> from vidphys.scenes.springs import springs
        >>> scene = springs()
        >>> start, law = scene.sample(4, Generator().manual_seed(0))
        >>> found = certify(scene, scene.simulate(start, law, steps=50))
        >>> found.finite.tolist(), float(found.drift.max()) < 0.1
        ([True, True, True, True], True)
    """
    energy = scene.energy(trajectory.states, trajectory.params)
    scale = scene.energy_scale(trajectory.at(0), trajectory.params)
    drift = (energy - energy[:, :1]).abs().amax(1) / scale
    if not conserving:
        drift = torch.full_like(drift, torch.nan)
    q = trajectory.states.q
    inside = torch.ones(len(q), dtype=torch.bool)
    if half_extent is not None:
        inside = scene.place(q).abs().amax((-3, -2, -1)) < half_extent
    return Certificate(
        trajectory.finite,
        drift,
        closest(q, scene.box).amin(-1),
        inside,
        scene.max_drift,
        scene.least_distance,
    )


def closest(q: Float[Tensor, "*b n d"], box: float | None = None) -> Float[Tensor, "*b"]:
    """The smallest distance between two bodies of each state; infinite for a single body."""
    bodies = q.shape[-2]
    if bodies < 2:
        return torch.full(q.shape[:-2], torch.inf, dtype=q.dtype)
    i, j = torch.triu_indices(bodies, bodies, offset=1)
    apart = PairLaw(box=box).nearest(q[..., i, :] - q[..., j, :])
    return apart.norm(dim=-1).amin(-1)
