"""A readout by attention, trained on any target, many at once on the same batches.

Each column of a target has a query that attends over the cells of a map; a small network reads the
column from what is attended to and from where that lies. Numbers are told with the error that is
expected of them, classes with probabilities. All widths, rates, seeds and targets of a fold are
trained side by side; each ends with the weights under which clips held out of its training were
likeliest, which also keeps it from being surer than it may be. The width and rate that were best
there are taken, as the mean over seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor, nn

from readouts.scale import FeatureScale
from vidphys.probing.folds import CrossValidation, Predictions
from vidphys.probing.readouts import ATTENTION, Readout
from vidphys.seeding import derive
from vidphys.training.early_stopping import BestWeights, StopSettings
from vidphys.training.learner import FitSettings, Learner
from vidphys.training.loop import fit_together

HELD_OUT = 5  # one clip of the training in so many decides which weights are kept
LEAST = 1e-3  # of a target's deviation: the smallest error that is expected


class AttentionProbe(nn.Module):
    """Maps to columns of a target.

    Args:
        channels, cells: of the maps.
        columns, numbers: k and m of the target, see :mod:`vidphys.probing.coding`.
        width: of keys, queries and values.
    """

    def __init__(self, channels: int, cells: int, columns: int, numbers: int, width: int) -> None:
        super().__init__()
        self.scale = FeatureScale(channels)
        self.query = nn.Parameter(torch.randn(columns, width))
        self.key, self.value = (nn.Linear(channels, width) for _ in range(2))
        self.place = nn.Parameter(torch.randn(cells, width) / width**0.5)
        self.read = nn.Sequential(
            nn.Linear(2 * width, width), nn.GELU(), nn.Linear(width, numbers + 1)
        )

    def forward(self, maps: Tensor) -> tuple[Tensor, Tensor]:
        """Columns ``(b, k, m)`` and the error expected of each ``(b, k, 1)``, standardised."""
        tokens = self.scale(maps.float().flatten(2).transpose(1, 2))
        score = self.query @ (self.key(tokens) + self.place).transpose(1, 2)
        attention = (score / self.query.shape[1] ** 0.5).softmax(-1)
        seen = torch.cat([attention @ self.value(tokens), attention @ self.place], -1)
        said = self.read(seen)
        return said[..., :-1], LEAST + nn.functional.softplus(said[..., -1:])


@dataclass(frozen=True)
class Attention(Readout):
    """See the module.

    Args:
        widths, rates: that are tried.
        seeds: initial weights of each, whose mean is told.
        steps, batch: of the optimiser.
    """

    widths: tuple[int, ...] = (32,)
    rates: tuple[float, ...] = (3e-3,)
    seeds: int = 2
    steps: int = 400
    batch: int = 64

    def __call__(self, maps: Tensor, asked: CrossValidation) -> list[Predictions]:
        for fold in asked.each_fold():
            jobs, test = [], torch.from_numpy(fold.test)
            for taught in fold.taught:
                for values in (taught.values, taught.exchanged):
                    if values is not None:
                        job = _Job(maps, values, taught.train, asked.groups, test, taught.classes)
                        jobs.append(job)
            told = self._fold(jobs, maps, asked.seed)
            for taught in fold.taught:
                said = taught.said
                said.forms[ATTENTION] += 1
                said.raw[fold.test], said.doubt[fold.test] = told.pop(0)
                if taught.exchanged is not None:
                    said.permuted[fold.test] = told.pop(0)[0]
        return asked.found

    def _fold(
        self, jobs: Sequence[_Job], maps: Tensor, seed: int
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Train everything of a fold at once; what is said and expected of the clips tested."""
        tried = [(width, rate) for width in self.widths for rate in self.rates]
        learners = [
            [[self._learner(job, *how, seed, k) for k in range(self.seeds)] for how in tried]
            for job in jobs
        ]
        every = [one for job in learners for how in job for one in how]
        fit_together(every, _Numbers(len(maps)), derive(seed, "order", "probes"))
        for one in every:
            assert one.best is not None
            one.best.restore()
        return [job.told(mine) for job, mine in zip(jobs, learners, strict=True)]

    def _learner(self, job: _Job, width: int, rate: float, seed: int, number: int) -> Learner:
        with torch.random.fork_rng([]):
            torch.manual_seed(derive(seed, "init", f"probe-{width}-{number}"))
            probe = job.probe(width)
        best = BestWeights(probe, partial(job.held_out, probe), self.steps, StopSettings(20, 6))
        settings = FitSettings(self.steps, self.batch, rate, clip=1.0)
        return Learner(probe, partial(job.loss, probe), settings, best)


class _Numbers:
    """Numbers of examples as batches: each job takes those of its own."""

    def __init__(self, count: int) -> None:
        self.count = count

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: Tensor) -> Tensor:
        return index


class _Job:
    """One target in one fold.

    Args:
        maps: of all examples.
        target: of those trained on, ``(n, k, m)``.
        train: their numbers.
        clips: of every example.
        test: numbers of those tested.
        classes: whether the m numbers are places among classes.
    """

    def __init__(
        self,
        maps: Tensor,
        target: np.ndarray,
        train: np.ndarray,
        clips: np.ndarray,
        test: Tensor,
        classes: bool,
    ) -> None:
        numbers = np.unique(clips[train])
        late = np.isin(clips[train], numbers[:: min(HELD_OUT, len(numbers))])
        self.maps, self.test, self.classes = maps, test, classes
        self.mean = 0 * target[0] if classes else target.mean(0)
        self.deviation = np.where(
            target.shape[-1] > 1, 1.0, target.std(0).clip(1e-12)
        )  # places among classes and on a circle have a scale of their own
        own = torch.from_numpy((target - self.mean) / self.deviation).float()
        index = torch.from_numpy(train)
        self.index, self.own = index[~late], own[~late]
        self.held_index, self.held = index[late], own[late]

    def probe(self, width: int) -> AttentionProbe:
        """An untrained one."""
        _, channels, *grid = self.maps.shape
        columns, numbers = self.own.shape[1:]
        probe = AttentionProbe(channels, grid[0] * grid[1], columns, numbers, width)
        probe.scale.fit(self.maps[self.index])
        return probe

    def loss(self, probe: AttentionProbe, batch: Tensor) -> Tensor:
        """Of the examples of a batch, whatever their number stands for."""
        index = batch % len(self.index)
        said, error = probe(self.maps[self.index[index]])
        return self._loss(said, error, self.own[index])

    def held_out(self, probe: AttentionProbe) -> float:
        """Of the clips held out."""
        with torch.no_grad():
            said, error = probe(self.maps[self.held_index])
            return float(self._loss(said, error, self.held))

    def _loss(self, said: Tensor, error: Tensor, true: Tensor) -> Tensor:
        if self.classes:
            return -(true * said.log_softmax(-1)).sum(-1).mean()
        return _likelihood(said, error, true)

    def told(self, learners: Sequence[Sequence[Learner]]) -> tuple[np.ndarray, np.ndarray]:
        """The mean over seeds of the way that was best on what was held out."""
        best = min(learners, key=lambda seeds: np.mean([one.best.error for one in seeds]))  # type: ignore[union-attr]
        with torch.no_grad():
            said = [one.modules(self.maps[self.test]) for one in best]
        values = torch.stack([value for value, _ in said])
        doubt = torch.stack([error for _, error in said]).numpy()
        if self.classes:
            return values.softmax(-1).mean(0).numpy(), np.zeros_like(doubt[0])
        spread = np.sqrt((doubt**2).mean(0) + values.numpy().var(0))
        return self.mean + self.deviation * values.numpy().mean(0), self.deviation * spread


def _likelihood(said: Tensor, error: Tensor, true: Tensor) -> Tensor:
    """Minus the logarithm, up to a constant, of a normal distribution about what is said.

    Errors that are expected to be large still pull (Seitzer et al., arXiv:2203.09168).
    """
    square = (said - true).square().mean(-1, keepdim=True)
    weight = error.detach()
    return (weight * (0.5 * square / error.square() + error.log())).mean()
