"""Whether the transport score says which model rolls out worst under the flip."""

from __future__ import annotations

from itertools import product

import torch
from torch import Generator, Tensor

from dynamics.stiffness import Stiffness
from vidphys import metrics
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.gravity.transport_score import flow, generator, linear_transport
from vidphys.experiments.linear.candidates import REPRESENTATIONS, fit_stiffness
from vidphys.experiments.linear.factorial import CURLS, FAMILIES, FLIPPED, PAIRS, Trial, make_trial
from vidphys.scenes.oscillators import CONFINEMENT, GROUNDED, coupling_stiffness, oscillators
from vidphys.seeding import derive
from vidphys.statistics import spearman

SECONDS = 5.0
TIMES = torch.linspace(0, SECONDS, 21, dtype=torch.float64)
INITIAL = (1e-3, 1e-1)  # size of the start's error, drawn evenly in its logarithm
COUPLED_AT = 1.0  # the trained coupling at which a model's content is read


def run_transport(task: CellTask) -> None:
    """All candidates of the factorial, at all amounts of curl, from starts that are a little off.

    Score and error are means over a run's episodes, pooled over all runs and ranked.
    """
    for seed in task.seeds:
        scores: list[Tensor] = []
        errors: list[Tensor] = []
        starts: list[Tensor] = []
        held: list[Tensor] = []
        for kind, curl in product(GROUNDED, CURLS):
            trial = make_trial(task, kind, curl, seed)
            for representation, family in product(REPRESENTATIONS, FAMILIES):
                score, error, start, bounded = _transport(
                    trial, kind, representation, family, derive(seed, kind, str(curl))
                )
                scores.append(score)
                errors.append(error)
                starts.append(start)
                held.append(bounded)
        _record(task, seed, *(torch.cat(x) for x in (scores, errors, starts, held)))


def _transport(
    trial: Trial, kind: str, representation: str, family: str, seed: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Log score, error at the end, the start's error, and whether the bound held, ``(pairs,)``."""
    matrices = fit_stiffness(trial.labels, family)
    if representation == "hamiltonian":
        matrices = 0.5 * (matrices + matrices.mT)
    stiffness = Stiffness(matrices, CONFINEMENT, family)
    at = torch.full((PAIRS,), FLIPPED, dtype=torch.float64)
    confined = CONFINEMENT * torch.eye(matrices.shape[-1], dtype=torch.float64)
    learned = stiffness.coupled(torch.full_like(at, COUPLED_AT)) / COUPLED_AT
    truth = generator(confined + FLIPPED * coupling_stiffness(kind)).expand(PAIRS, -1, -1)
    deployed = generator(stiffness(at))
    x = trial.start.flat
    off = _offset(x, seed)
    reference = flow(truth.unsqueeze(1), x, TIMES)
    predicted = flow(deployed.unsqueeze(1), x + off, TIMES)
    radius = torch.maximum(reference.norm(dim=-1), predicted.norm(dim=-1)).amax((-2, -1))
    initial = off.norm(dim=-1).mean(1)
    terms = linear_transport(
        deployed, generator(confined + FLIPPED * learned), truth, initial, radius
    )
    distance = (predicted - reference).norm(dim=-1)
    # Every episode of a pair starts equally far off, so that one bound holds for all of them.
    bound = torch.stack([terms.log_score(t) for t in TIMES], -1).exp().unsqueeze(1)
    held = (distance <= bound * (1 + 1e-9)).double().mean((1, 2))
    end = TIMES[-1]
    return terms.log_score(end), distance[..., -1].mean(1), initial, held


def _offset(x: Tensor, seed: int) -> Tensor:
    """Errors of the starts: one size for a pair, a random direction for each episode."""
    rng = Generator().manual_seed(seed)
    low, high = (torch.tensor(bound, dtype=torch.float64).log() for bound in INITIAL)
    size = (low + (high - low) * torch.rand(len(x), generator=rng, dtype=x.dtype)).exp()
    way = torch.randn(x.shape, generator=rng, dtype=x.dtype)
    return size[:, None, None] * way / way.norm(dim=-1, keepdim=True)


def _record(
    task: CellTask, seed: int, scores: Tensor, errors: Tensor, starts: Tensor, held: Tensor
) -> None:
    recorder = task.recorder(seed, oscillators(), "all")
    ranked = spearman(scores.tolist(), errors.tolist())
    alone = spearman(starts.tolist(), errors.tolist())
    recorder.add_value("spearman_score", ranked)
    recorder.add_value("spearman_initial", alone)
    recorder.add_value("spearman_gain", ranked - alone)
    recorder.add("bound_held", metrics.mean(held))
    recorder.add_episodes("log_score", scores)
    recorder.add_episodes("error", errors)
    recorder.add_episodes("initial", starts)


TRANSPORT = Table.told(
    "transport",
    cells={"oscillators": run_transport},
    settings={"seconds": SECONDS, "initial": INITIAL, "curls": CURLS},
)
