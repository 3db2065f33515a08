"""Disks on a periodic torus that touch softly, stiffly or without any give."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from dynamics import Hamiltonian, PairLaw, Parameters, PhaseState, Rollout
from dynamics.contact import SoftContact
from dynamics.events import HardDisks
from dynamics.kinetic import FixedKinetic
from dynamics.rolling import first_bad_step
from vidphys.errors import InputError
from vidphys.scenes.draws import Range, at_rest, normal, uniform
from vidphys.scenes.scene import Sampler, Scene

DIAMETER = 0.6  # world units: disks of radius 0.3
BOX = 4.0  # world units
SPEED_STD = 1.0
DT = 0.002  # seconds
SPREAD: Range = (0.5, 1.5)  # of the stiffness, times its level
STIFFNESS = {"soft": 30.0, "stiff": 300.0}
LEVELS = (*STIFFNESS, "impulsive")
MAX_DRAWS = 1000
OVERLAP = 1e-9  # world units: rounding of a bounce


def disks(level: str = "soft", bodies: int = 4) -> Scene:
    """Unit masses on a torus of side 4, with the contact stiffness of a level.

    Args:
        level: ``soft`` (k about 30), ``stiff`` (about 300), or ``impulsive``: hard disks, moved
            from collision to collision. k is the coupling; hard disks have none, theirs is 1.
        bodies: N, at most as many as find room.

    Raises:
        InputError: unknown level.
    """
    if level not in LEVELS:
        raise InputError(f"disks: unknown level '{level}'; use one of {', '.join(LEVELS)}")
    settings = {
        "level": level,
        "diameter": DIAMETER,
        "box": BOX,
        "mass": 1.0,
        "speed_std": SPEED_STD,
        "dt_seconds": DT,
    }
    name = f"disks-{level}"
    if level == "impulsive":
        return HardDiskScene(
            name,
            HardDisks(BOX, DIAMETER),
            _sampler(bodies, (1.0, 1.0)),
            bodies,
            DT,
            settings,
            max_drift=1e-9,
            box=BOX,
            least_distance=DIAMETER - OVERLAP,
            half_extent=BOX / 2,
            derivatives_without="bounces",
        )
    k = STIFFNESS[level]
    stiffness = (SPREAD[0] * k, SPREAD[1] * k)
    law = Hamiltonian(FixedKinetic(), SoftContact(DIAMETER, PairLaw("alike", box=BOX)))
    sample = _sampler(bodies, stiffness)
    settings["coupling"] = stiffness
    return Scene(
        name, law, sample, bodies, DT, settings, max_drift=0.01, box=BOX, half_extent=BOX / 2
    )


@dataclass(frozen=True)
class HardDiskScene(Scene):
    """A scene whose truth flies from collision to collision, whatever the stored interval."""

    def simulate(
        self, start: PhaseState, params: Parameters, steps: int, every: int = 1
    ) -> Rollout:
        """The reference trajectory, exact to rounding."""
        assert isinstance(self.law, HardDisks)
        params = params.map(torch.Tensor.double)
        state = start.map(torch.Tensor.double)
        stored = [state]
        for _ in range(steps // every):
            state, _ = self.law.advance(state, params, self.dt * every)
            stored.append(state)
        states = PhaseState.stack(stored, -3)
        return Rollout(states, params, self.dt * every, first_bad_step(states))


def _sampler(bodies: int, stiffness: Range) -> Sampler:
    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        params = Parameters(
            uniform((n,), stiffness, rng), torch.ones(n, bodies, dtype=torch.float64)
        )
        velocity = normal((n, bodies, 2), SPEED_STD, rng)
        return at_rest(_apart(n, bodies, rng), velocity, params), params

    return sample


def _apart(n: int, bodies: int, rng: Generator) -> Tensor:
    """Places of disks that do not touch; episodes in which some do are drawn again."""
    q = uniform((n, bodies, 2), (0.0, BOX), rng)
    for _ in range(MAX_DRAWS):
        again = touching(q)
        if not bool(again.any()):
            return q
        q[again] = uniform((int(again.sum()), bodies, 2), (0.0, BOX), rng)
    raise InputError(f"disks: no room for {bodies} disks of diameter {DIAMETER} in a box of {BOX}")


def touching(q: Tensor) -> Tensor:
    """Whether any two disks of ``(..., n, d)`` are nearer than their diameter."""
    i, j = torch.triu_indices(q.shape[-2], q.shape[-2], offset=1)
    apart = PairLaw("alike", box=BOX).nearest(q[..., i, :] - q[..., j, :])
    return (apart.norm(dim=-1) < DIAMETER).any(-1)
