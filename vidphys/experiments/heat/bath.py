"""Stochastic heads on true states: what they learn from, what they learn by, what they are asked.

Training is by the likelihood of one-step increments: exact under the model's own bath, Gaussian
(Euler-Maruyama) for a neural SDE, and squared error for a model without noise. A bath has few
numbers; after the network's training they are set to their maximum likelihood on all data.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from dynamics import Hamiltonian, Head, PhaseState, Rollout
from dynamics.bath import Bath, DiagonalBath
from dynamics.stochastic import NeuralSDE, half_steps
from dynamics.terms import HeadTerm
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.members import Examples
from vidphys.experiments.core.trained import Training, train_cell
from vidphys.placement import device_of, moved
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene
from vidphys.scenes.langevin import BathScene
from vidphys.seeding import derive
from vidphys.training.segments import Scale, Segments, from_trajectory

SHORTEST, LONGEST = 200, 1000  # steps of a training trajectory
THIN = 4  # the network learns from every fourth step; the bath's numbers from all


def bath_trajectory(scene: BathScene, trajectories: int, seed: int, observed: int) -> Rollout:
    """Training trajectories: from hot starts through the relaxation into the steady state.

    Args:
        scene: gives the truth.
        trajectories: how many.
        seed: of starts and noise.
        observed: steps that all of them should have together: it bounds how well a rate is known.
    """
    rng = Generator().manual_seed(derive(seed, "train"))
    start, params = scene.sample(trajectories, rng)
    steps = max(SHORTEST, min(LONGEST, observed // trajectories))
    return scene.simulate(start, params, steps, seed=derive(seed, "train", "noise"))


def bath_examples(trajectory: Rollout) -> Examples:
    """One-step examples of it; whole trajectories are held out."""
    trajectories, states = trajectory.states.q.shape[:2]
    starts = len(range(0, states - 1, THIN))
    segments = from_trajectory(trajectory, k=1, step=THIN)
    return Examples(*segments.split(starts * max(1, trajectories // 16)))


def likelihood(head: Head, batch: Segments, scale: Scale) -> Tensor:
    """The loss of every stochastic head; see the module's first lines."""
    assert batch.p is not None
    step = PhaseState(batch.q.squeeze(-3), batch.p.squeeze(-3))
    if isinstance(head, NeuralSDE):
        return head.nll(batch.start, step, batch.params, batch.dt).mean()
    assert isinstance(head, Hamiltonian)
    halves = half_steps(head, batch.start, step, batch.params, batch.dt)
    bath = bath_of(head)
    if bath is None:
        return halves.squared_error().mean() / scale.p**2
    return halves.nll(bath, batch.params, batch.dt).mean()


def bath_of(head: Hamiltonian) -> Bath | None:
    """The bath among a model's ports."""
    return next((port for port in head.ports if isinstance(port, Bath)), None)


def refine(head: Head, trajectory: Rollout) -> None:
    """Set a diagonal bath's numbers to their maximum likelihood on every step of a trajectory.

    The potential is held. Of an episode only the sums of squares of the half steps count, so that
    all data costs one pass.
    """
    bath = bath_of(head) if isinstance(head, Hamiltonian) else None
    if not isinstance(bath, DiagonalBath):
        return
    assert isinstance(head, Hamiltonian)
    with torch.no_grad():
        before, across, after = _squares(head, trajectory)
    count, device = 2 * (trajectory.states.q.shape[1] - 1), device_of(head)
    params = moved(trajectory.params, device, torch.float64)
    bath.double()
    optimiser = torch.optim.LBFGS(bath.parameters(), max_iter=100, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        decay, variance = bath.moments(params, trajectory.dt / 2)
        error = (after - 2 * decay * across + decay.square() * before) / variance
        total = 0.5 * (error + count * variance.log().expand_as(before)).sum() / count / len(before)
        total.backward()
        return total

    optimiser.step(loss)
    bath.float()


def _squares(head: Hamiltonian, trajectory: Rollout) -> list[Tensor]:
    """Sums over an episode's half steps of before^2, before * after, after^2, ``(b, n, d)``."""
    parts = []
    for episodes in torch.arange(len(trajectory.states.q)).split(256):
        states = moved(trajectory.states[episodes], device_of(head))
        start = states[:, :-1].map(Tensor.float)
        step = PhaseState(states.q.diff(dim=1).float(), states.p.diff(dim=1).float())
        law = moved(trajectory.params[episodes], device_of(head), torch.float32)
        params = law.map(lambda x: x.unsqueeze(1))
        force = head.force(states.map(Tensor.float), params)
        ends = force[:, :-1], force[:, 1:]
        halves = half_steps(head, start, step, params, trajectory.dt, ends)
        before, after = halves.before.double(), halves.after.double()
        products = before * before, before * after, after * after
        parts.append([x.sum((0, 2)) for x in products])
    return [torch.cat(x) for x in zip(*parts, strict=True)]


def train_stochastic(
    name: str, term: HeadTerm, scene: BathScene, task: CellTask, observed: int, noise: float = 0.0
) -> list[tuple[int, Head, Recorder]]:
    """Train a head of this term for each seed on the scene's trajectories.

    Args:
        name: of the head.
        term: the model.
        scene: gives the data.
        task: gives sizes, device and the folder.
        observed: steps of training data, see :func:`bath_trajectory`.
        noise: of what a sensor reports: standard deviation as a part of the state's own.

    Returns:
        Seed, head and recorder of each training that was not lost.
    """
    seen: dict[int, Rollout] = {}

    def examples(world: Scene, trajectories: int, seed: int) -> Examples:
        seen[seed] = blurred(bath_trajectory(scene, trajectories, seed, observed), noise, seed)
        return bath_examples(seen[seed])

    how = Training(loss=likelihood, examples=examples, checkpoint=f"fit-{name}-{noise:g}")
    trained = train_cell(task, name, term, scene, how)
    for seed, head, _ in trained:
        refine(head, seen[seed])
    return trained


def blurred(trajectory: Rollout, noise: float, seed: int) -> Rollout:
    """The same trajectory as a sensor with independent noise would report it."""
    if not noise:
        return trajectory
    rng = Generator().manual_seed(derive(seed, "measurement"))

    def noisy(x: Tensor) -> Tensor:
        return x + noise * x.std() * torch.randn(x.shape, generator=rng, dtype=x.dtype)

    states = trajectory.states.map(noisy)
    return Rollout(states, trajectory.params, trajectory.dt, trajectory.first_bad, trajectory.seed)
