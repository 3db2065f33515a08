"""Bodies that attract each other in a trap, in a heat bath, with or without a drive.

The softening is 0.5, not gravity's 0.1: at temperature 0.5 a pair would be bound twenty times
deeper than the bath can lift, and the bath would hold one frozen cluster. k_B = 1 throughout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from dynamics import Hamiltonian, Parameters, PhaseState, Rollout, rollout
from dynamics.bath import ExactBath
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap, SoftenedGravity, SumPotential
from vidphys.errors import InputError
from vidphys.scenes.scene import Scene

BATHS = ((0.5, 0.5), (0.5, 1.0), (2.0, 0.5), (2.0, 1.0))  # (friction per second, temperature)
DRIVES = (0.0, 0.5, 1.0)  # per second, those that are trained on
DRIVEN_BATH = (2.0, 1.0)
SOFTENING, TRAP = 0.5, 1.0
DT = 0.05  # seconds
# Hotter than every bath: a model that only conserves energy cannot be at the right temperature.
POSITION_STD, START_TEMPERATURE = 1.0, 3.0
HALF_EXTENT = 6.0  # world units: three times the spread that so hot a start has in the trap


@dataclass(frozen=True)
class BathScene(Scene):
    """A scene whose truth is stochastic: its rollouts take a seed."""

    @property
    def exact(self) -> Hamiltonian:
        """The law as a head that can be rolled like a learned one."""
        assert isinstance(self.law, Hamiltonian)
        return self.law

    def simulate(
        self,
        start: PhaseState,
        params: Parameters,
        steps: int,
        every: int = 1,
        seed: int | None = None,
    ) -> Rollout:
        """The reference rollout in float64, its noise drawn under ``seed``."""
        start, params = start.map(torch.Tensor.double), params.map(torch.Tensor.double)
        return rollout(self.exact, start, params, steps, self.dt, every, seed)


def langevin(baths: Sequence[tuple[float, float]] = BATHS, bodies: int = 3) -> BathScene:
    """Confined Langevin bodies, each episode in one of several baths.

    Args:
        baths: (friction per second > 0, temperature > 0) of each.
        bodies: N.

    Raises:
        InputError: no bath, or one that is not positive.
    """
    return _scene("langevin", baths, None, bodies)


def driven(drives: Sequence[float] = DRIVES, bodies: int = 3) -> BathScene:
    """The same at friction 2 and temperature 1 under a linear drive against the friction.

    Args:
        drives: A per second, each below the friction: training data has a steady state.
        bodies: N.

    Raises:
        InputError: no drive, or one that is at least the friction.
    """
    if not drives or max(drives) >= DRIVEN_BATH[0]:
        raise InputError(
            f"driven: drives {list(drives)} must be given and below the friction "
            f"{DRIVEN_BATH[0]:g}: at or above it there is no steady state"
        )
    return _scene("driven", (DRIVEN_BATH,), drives, bodies)


def _scene(
    name: str, baths: Sequence[tuple[float, float]], drives: Sequence[float] | None, bodies: int
) -> BathScene:
    if not baths or min(min(bath) for bath in baths) <= 0:
        raise InputError(f"{name}: baths {list(baths)} must be given, friction and temperature > 0")
    law = Hamiltonian(
        FixedKinetic(),
        SumPotential([SoftenedGravity(SOFTENING), HarmonicTrap(TRAP)]),
        ports=[ExactBath()],
    )

    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        chosen = _pick(baths, n, rng)
        scalars = {"friction": chosen[:, 0], "temperature": chosen[:, 1]}
        if drives is not None:
            scalars["drive"] = _pick([(x,) for x in drives], n, rng)[:, 0]
        ones = torch.ones(n, dtype=torch.float64)
        params = Parameters(ones, ones.unsqueeze(-1).expand(n, bodies).clone(), None, scalars)
        q = POSITION_STD * torch.randn(n, bodies, 2, generator=rng, dtype=torch.float64)
        p = START_TEMPERATURE**0.5 * torch.randn(n, bodies, 2, generator=rng, dtype=torch.float64)
        return PhaseState(q, p), params

    settings = {
        "baths": [list(bath) for bath in baths],
        "drives": None if drives is None else list(drives),
        "softening": SOFTENING,
        "trap": TRAP,
        "mass": 1.0,
        "coupling": 1.0,
        "start_temperature": START_TEMPERATURE,
        "dt_seconds": DT,
        "splitting": "half bath, leapfrog, half bath",
    }
    return BathScene(
        name,
        law,
        sample,
        bodies,
        DT,
        settings,
        half_extent=HALF_EXTENT,
        derivatives_without="noise of the bath",
    )


def _pick(rows: Sequence[tuple[float, ...]], n: int, rng: Generator) -> Tensor:
    table = torch.tensor(rows, dtype=torch.float64)
    return table[torch.randint(len(rows), (n,), generator=rng)]
