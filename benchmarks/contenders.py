"""Models, episodes and training problems that the benchmark's contenders share."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from dynamics import HEADS, Hamiltonian, Parameters, PhaseState, build, terms
from dynamics.potentials import PairPotential, SoftenedGravity
from vidphys.scenes.gravity import SOFTENING, gravity
from vidphys.training.loop import FitSettings, fit
from vidphys.training.segments import Segments

DT = 0.002  # seconds
WIDTH = 256  # of the networks in rollouts
FIT = FitSettings(150, 256, 5e-3)  # to the true pair force
RATE = 1e-3  # of training steps that are timed
SLOW = 0.2  # momenta of a plunge, times those of the scene: the bodies fall into each other


class _Places:
    """Displacements whose distances are spread evenly in their logarithm, 0.02 to 20."""

    def __init__(self, count: int, seed: int) -> None:
        rng = Generator().manual_seed(seed)
        distance = 0.02 * 1000 ** torch.rand(count, 1, generator=rng)
        turn = 2 * torch.pi * torch.rand(count, 1, generator=rng)
        self.places = distance * torch.cat([turn.cos(), turn.sin()], -1)

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: Tensor) -> Tensor:
        return self.places[index]


def fitted(potential: terms.Pair, seed: int = 0) -> Hamiltonian:
    """A factored model whose pair force was fitted to softened gravity's, float32.

    Args:
        potential: a network of the displacement, or of the distance.
        seed: of its weights and of the places.
    """
    torch.manual_seed(seed)
    head = build(terms.Hamiltonian(potentials=(potential,)), bodies=3, dt=DT)
    assert isinstance(head, Hamiltonian) and isinstance(head.potential, PairPotential)
    learned, true = head.potential, SoftenedGravity(SOFTENING)

    def loss(places: Tensor) -> Tensor:
        force = true.pair_gradient(places)
        wrong = (learned.pair_gradient(places) - force).square().sum(-1)
        return (wrong / force.square().sum(-1)).mean()

    fit(head, loss, _Places(8192, seed), FIT, seed)
    return head.requires_grad_(False)


def episodes(count: int, plunge: bool = False, seed: int = 0) -> tuple[PhaseState, Parameters]:
    """Three bodies under gravity, float32: near-circular, or falling into close encounters."""
    scene = gravity("gaussian" if plunge else "ring")
    start, params = scene.sample(count, Generator().manual_seed(seed))
    if plunge:
        start = PhaseState(start.q, SLOW * start.p)
    return start.map(Tensor.float), params.map(Tensor.float)


@dataclass(frozen=True)
class Problem:
    """One-step prediction: a model, where bodies start, and their increments after a step."""

    head: Hamiltonian
    start: PhaseState
    params: Parameters
    target: PhaseState

    @property
    def segments(self) -> Segments:
        """The same examples as training takes them."""
        q, p = self.target.q.unsqueeze(1), self.target.p.unsqueeze(1)
        return Segments(self.start, self.params, q, p, DT, 1)


def problem(width: int, batch: int, seed: int = 0) -> Problem:
    """A fresh factored model and ``batch`` examples under gravity."""
    torch.manual_seed(seed)
    head = build(HEADS["factored"].throughout(width=width), bodies=3, dt=DT)
    assert isinstance(head, Hamiltonian)
    start, params = episodes(batch, seed=seed)
    target = PhaseState(DT * start.p, DT * torch.randn_like(start.p))
    return Problem(head, start, params, target)
