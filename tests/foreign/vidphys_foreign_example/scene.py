"""Two bodies that attract each other under a screened law."""

import torch
from torch import Generator

from dynamics import Hamiltonian, Parameters, PhaseState
from dynamics.kinetic import FixedKinetic
from vidphys.scenes import Scene
from vidphys_foreign_example.law import YukawaPotential

REACH, SOFTENING, DT = 1.5, 0.2, 0.002


def sample(episodes: int, rng: Generator) -> tuple[PhaseState, Parameters]:
    """Opposite places on a circle, opposite speeds across it."""
    turn = 2 * torch.pi * torch.rand(episodes, generator=rng, dtype=torch.float64)
    along = torch.stack([turn.cos(), turn.sin()], -1)
    across = torch.stack([-turn.sin(), turn.cos()], -1)
    speed = 0.3 + 0.3 * torch.rand(episodes, 1, generator=rng, dtype=torch.float64)
    q, p = torch.stack([along, -along], 1), torch.stack([speed * across, -speed * across], 1)
    coupling = 0.5 + torch.rand(episodes, generator=rng, dtype=torch.float64)
    return PhaseState(q, p), Parameters(coupling, torch.ones(episodes, 2, dtype=torch.float64))


def screened_pair() -> Scene:
    """The scene."""
    law = Hamiltonian(FixedKinetic(), YukawaPotential(REACH, SOFTENING).double())
    law.requires_grad_(False)
    settings = {"reach": REACH, "softening": SOFTENING, "dt_seconds": DT}
    return Scene("screened-pair", law, sample, 2, DT, settings)
