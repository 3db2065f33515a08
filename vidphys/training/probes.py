"""Training probes of positions and momenta over cached features, all seeds on the same batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Generator, Tensor

from dynamics import PhaseState
from readouts.probes import StateProbe
from vidphys.data.labelled import LabelledFrames, Shifted
from vidphys.placement import CPU, device_of, moved, suited
from vidphys.progress import Progress
from vidphys.seeding import derive
from vidphys.training.early_stopping import BestWeights, StopSettings
from vidphys.training.learner import FitSettings, Learner
from vidphys.training.loop import fit_together
from vidphys.training.readouts import SCORED_AT_ONCE

CELLS = 2  # largest random move of a training map, in cells
DROPPED = 0.3  # share of the attended features that a momentum is not read from in training


@dataclass(frozen=True)
class StateFrames(LabelledFrames):
    """Feature frames with known positions and momenta.

    Args:
        momenta: ``(f, n, 2)``, in the momentum unit of :class:`Units`.
    """

    momenta: Tensor

    def __getitem__(self, index: Tensor | slice) -> StateFrames:
        return StateFrames(
            self.values[index],
            self.centres,
            self.targets[index],
            self.weight[index],
            self.momenta[index],
        )


@dataclass(frozen=True)
class Units:
    """What probes speak in: normalised image units, and the training momenta's deviation.

    Args:
        length: world units of one normalised image unit.
        momentum: momentum of one unit, world units.
    """

    length: float
    momentum: float

    @classmethod
    def of(cls, states: PhaseState, half_extent: float) -> Units:
        """Units for a set of training states and a camera."""
        return cls(half_extent, float(states.p.std()))

    def frames(self, values: Tensor, centres: Tensor, states: PhaseState) -> StateFrames:
        """Features ``(f, c, h, w)`` with their true states ``(f, n, 2)`` in world units."""
        q, p = states.q.float() / self.length, states.p.float() / self.momentum
        return StateFrames(values, centres, q, torch.ones(q.shape[:-1]), p)

    def read(self, probe: StateProbe, values: Tensor, centres: Tensor) -> PhaseState:
        """What a probe says of feature frames, world units, ``(f, n, 2)``."""
        with torch.no_grad():
            some = [suited((v, centres), probe) for v in values.split(SCORED_AT_ONCE)]
            parts = [moved(probe.read_state(*each), CPU) for each in some]
        q, p = (torch.cat(x).double() for x in zip(*parts, strict=True))
        return PhaseState(self.length * q, self.momentum * p)


def train_probes(
    train: StateFrames,
    held_out: StateFrames,
    seeds: Sequence[int],
    settings: FitSettings,
    name: str,
    save_to: Path | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
) -> list[StateProbe]:
    """One probe for each seed, each with the weights that were its best on the held-out frames.

    All are trained on the same batches, of which each is read once; the seeds give the initial
    weights.

    Args:
        train: frames to learn from.
        held_out: frames that decide which weights are kept.
        seeds: of the initial weights.
        settings: of the optimiser.
        name: of the random streams.
        save_to: JSON path of the checkpoint.
        progress: called as ``(step, steps, loss)``.
        device: where they are trained, and stay.
    """
    spread = float(train.targets.std())
    learners, probes = [], []
    for seed in seeds:
        torch.manual_seed(derive(seed, "init", name))
        probe = StateProbe(train.values.shape[1], train.targets.shape[1]).to(device)
        probe.fit_scale(train.values)
        error = partial(_mean_error, probe, held_out, spread)
        best = BestWeights(probe, error, settings.steps, StopSettings())
        learners.append(Learner(probe, partial(_loss, probe, spread), settings, best))
        probes.append(probe)
    data = Shifted(train, CELLS)
    fit_together(learners, data, derive(0, "order", name), save_to, progress)
    for learner in learners:
        assert learner.best is not None
        learner.best.restore()
    return [probe.eval() for probe in probes]


def _loss(probe: StateProbe, spread: float, batch: StateFrames) -> Tensor:
    """What is minimised: the error with some of the attended features left out."""
    return _error(probe, spread, batch, _dropout(batch, probe.query.shape[-1]))


def _error(
    probe: StateProbe, spread: float, batch: StateFrames, kept: Tensor | None = None
) -> Tensor:
    """Squared errors of both halves of the state, each in units of its own deviation."""
    q, p = probe.read_state(batch.values, batch.centres, kept)
    square = ((q - batch.targets) / spread).square() + (p - batch.momenta).square()
    return (batch.weight * square.mean(-1)).sum() / batch.weight.sum().clamp_min(1e-12)


def _dropout(batch: StateFrames, width: int) -> Tensor:
    """Factors of dropout, drawn by the batch itself: the same whoever is trained beside.

    The batch's numbers are summed on the CPU: a card sums in another order, which draws others.
    """
    drawn_by = int(batch.targets.cpu().double().square().sum() * 1e9) % 2**62
    rng = Generator().manual_seed(drawn_by)
    kept = torch.rand(*batch.targets.shape[:2], width, generator=rng) >= DROPPED
    return (kept / (1 - DROPPED)).to(batch.targets.device)


def _mean_error(probe: StateProbe, frames: StateFrames, spread: float) -> float:
    numbers = torch.arange(len(frames)).split(SCORED_AT_ONCE)
    with torch.no_grad():
        some = [moved(frames[i], device_of(probe)) for i in numbers]
        errors = [float(_error(probe, spread, each)) * len(each) for each in some]
    return sum(errors) / len(frames)
