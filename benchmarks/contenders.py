"""Models and episodes that the benchmark's contenders share."""

from __future__ import annotations

import copy

import torch
from torch import Generator, Tensor

from dynamics import Hamiltonian, Parameters, PhaseState, build
from dynamics.compiled import compile_head
from dynamics.potentials import PairPotential, SoftenedGravity
from dynamics.terms import HamiltonianTerms
from vidphys.scenes.gravity import SOFTENING, gravity
from vidphys.training.loop import FitSettings, fit

BODIES_DT = 0.002  # seconds
WIDTH = 256  # of the networks in rollouts
STEPS, BATCH, RATE = 150, 256, 5e-3  # of the fit to the true pair force
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


def fitted(potential: str, width: int, seed: int = 0) -> Hamiltonian:
    """A factored model whose pair force was fitted to softened gravity's, float32.

    Args:
        potential: ``displacement`` or ``radial``.
        width: of the network.
        seed: of its weights and of the places.
    """
    torch.manual_seed(seed)
    head = build(HamiltonianTerms(potential=potential, width=width), bodies=3, dt=BODIES_DT)  # type: ignore[arg-type]
    assert isinstance(head, Hamiltonian) and isinstance(head.potential, PairPotential)
    learned, true = head.potential, SoftenedGravity(SOFTENING)

    def loss(places: Tensor) -> Tensor:
        force = true.pair_gradient(places)
        wrong = (learned.pair_gradient(places) - force).square().sum(-1)
        return (wrong / force.square().sum(-1)).mean()

    fit(head, loss, _Places(8192, seed), FitSettings(STEPS, BATCH, RATE), seed)
    return head.requires_grad_(False)


def episodes(count: int, plunge: bool = False, seed: int = 0) -> tuple[PhaseState, Parameters]:
    """Three bodies under gravity, float32: near-circular, or falling into close encounters."""
    scene = gravity("gaussian" if plunge else "ring")
    start, params = scene.sample(count, Generator().manual_seed(seed))
    if plunge:
        start = PhaseState(start.q, SLOW * start.p)
    return start.map(Tensor.float), params.map(Tensor.float)


def deviations(head: Hamiltonian, plunge: bool, steps: int, dt: float) -> dict[str, Tensor]:
    """Largest |dq| of each episode from the float64 network, of its float32 forms; and how close.

    Returns:
        ``network`` and ``compiled``, ``(episodes,)`` each, and ``nearest`` distances.
    """
    start, params = episodes(64, plunge)
    exact = compile_head(copy.deepcopy(head).double(), None)
    wide = start.map(Tensor.double), params.map(Tensor.double)
    truth = exact.trajectory(*wide, steps, dt).states.q
    found = {}
    with torch.no_grad():
        for name, model in (
            ("network", compile_head(head, None, backend="torch")),
            ("compiled", compile_head(head)),
        ):
            q = model.trajectory(start, params, steps, dt).states.q
            found[name] = (q - truth).norm(dim=-1).flatten(1).amax(-1)
    apart = truth - truth.roll(1, -2)
    return {**found, "nearest": apart.norm(dim=-1).flatten(1).amin(-1)}
