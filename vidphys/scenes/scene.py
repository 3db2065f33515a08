"""A scene: a law, a generator of episodes, and the float64 truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Generator, Tensor

from dynamics import Hamiltonian, Parameters, PhaseState, Rollout, rollout
from dynamics.state import kinetic_energy

Sampler = Callable[[int, Generator], tuple[PhaseState, Parameters]]


@dataclass(frozen=True)
class Scene:
    """One system of the study.

    Args:
        name: as it stands in the records.
        law: the exact Hamiltonian; it has no learned parts.
        sample: ``(episodes, generator) -> (state, params)`` in float64.
        bodies: number of bodies.
        dt: seconds, the reference step.
        settings: ranges of the generator, for the record.
    """

    name: str
    law: Hamiltonian
    sample: Sampler
    bodies: int
    dt: float
    settings: dict[str, Any] = field(default_factory=dict)

    def simulate(
        self, start: PhaseState, params: Parameters, steps: int, every: int = 1
    ) -> Rollout:
        """The reference rollout in float64 by the scene's own integrator and step."""
        return rollout(
            self.law,
            start.map(torch.Tensor.double),
            params.map(torch.Tensor.double),
            steps,
            self.dt,
            every,
        )

    def energy(self, states: PhaseState, params: Parameters) -> Tensor:
        """True energy of states ``(b, t, n, d)`` under per-episode parameters, ``(b, t)``."""
        params = params.map(lambda x: x.double().unsqueeze(1))
        return self.law.energy(states.map(torch.Tensor.double), params)

    def energy_scale(self, start: PhaseState, params: Parameters) -> Tensor:
        """K + |V| of a start state, ``(b,)``: what an energy near zero is measured against."""
        params = params.map(torch.Tensor.double)
        start = start.map(torch.Tensor.double)
        kinetic = kinetic_energy(start.p, params.mass)
        return kinetic + (self.law.energy(start, params) - kinetic).abs()


@dataclass(frozen=True)
class Certificate:
    """What was checked of each generated episode, ``(b,)`` each."""

    finite: Tensor
    drift: Tensor
    in_frame: Tensor

    @property
    def passed(self) -> Tensor:
        return self.finite & self.in_frame & (self.drift < MAX_REFERENCE_DRIFT)


MAX_REFERENCE_DRIFT = 0.1


def certify(scene: Scene, trajectory: Rollout, half_extent: float | None = None) -> Certificate:
    """Check a reference rollout: finite, energy drift bounded, bodies inside the viewport.

    Args:
        scene: whose energy is used.
        trajectory: states ``(b, t, n, d)``.
        half_extent: world units; ``None`` asks nothing of the viewport.
    """
    energy = scene.energy(trajectory.states, trajectory.params)
    scale = scene.energy_scale(trajectory.at(0), trajectory.params)
    drift = (energy - energy[:, :1]).abs().amax(1) / scale
    reach = trajectory.states.q.abs().amax((-3, -2, -1))
    inside = reach < half_extent if half_extent else torch.ones_like(reach, dtype=torch.bool)
    return Certificate(trajectory.finite, drift, inside)
