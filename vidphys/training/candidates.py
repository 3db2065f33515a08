"""Many readouts over the same cached features, trained in one pass; the best one is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import torch
from torch import nn

from readouts.attention import AttentionReadout
from readouts.pooled import pooled_twin
from vidphys.data.labelled import LabelledFrames
from vidphys.progress import Progress
from vidphys.training.readouts import ReadoutFit, ReadoutSettings, train_readouts

ATTENTION, POOLED = "attention", "pooled"


@dataclass(frozen=True)
class Grid:
    """What the readouts over one layer differ in.

    Args:
        widths: of the attention readout; each has a pooled twin of the same budget.
        learning_rates: peaks.
        seeds: of initial weights.
    """

    widths: tuple[int, ...] = (128,)
    learning_rates: tuple[float, ...] = (3e-3,)
    seeds: tuple[int, ...] = (0,)


@dataclass(frozen=True)
class Candidate:
    """One readout of a grid."""

    kind: str
    layer: int | str | None
    width: int
    learning_rate: float
    seed: int

    @property
    def name(self) -> str:
        """As it stands in the records."""
        layer = "" if self.layer is None else f"-layer{self.layer}"
        return f"{self.kind}{layer}-width{self.width}-rate{self.learning_rate:g}-seed{self.seed}"

    def build(self, channels: int, bodies: int) -> nn.Module:
        """The untrained readout."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            attention = AttentionReadout(channels, bodies, self.width)
            if self.kind == ATTENTION:
                return attention
            return pooled_twin(attention, channels, bodies)


@dataclass(frozen=True)
class TrainedReadout:
    """A candidate and what became of it."""

    candidate: Candidate
    module: nn.Module
    fit: ReadoutFit


@dataclass(frozen=True)
class Examples:
    """Frames of one layer to train on and to stop by."""

    train: LabelledFrames
    held_out: LabelledFrames


def train_grid(
    grid: Grid,
    layer: int | str | None,
    examples: Examples,
    settings: ReadoutSettings,
    seed: int,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> list[TrainedReadout]:
    """Train all readouts of a grid over one layer.

    Args:
        grid: see :class:`Grid`.
        layer: the layer that the examples are of.
        examples: all of them are trained and compared on these.
        settings: of the training; the attention readouts' maps are moved, the pooled ones' not.
        seed: of the batch order.
        folder: for checkpoints.
        progress: called as ``(step, steps, loss)``.
    """
    # pooling is blind to a move: moved maps would only teach the control that position is noise
    still = ReadoutSettings(settings.fit, 0, settings.stop)
    channels, queries = examples.train.values.shape[1], examples.train.targets.shape[1]
    trained = []
    for kind, how in ((ATTENTION, settings), (POOLED, still)):
        members = {
            each.name: each
            for each in (
                Candidate(kind, layer, *axes)
                for axes in product(grid.widths, grid.learning_rates, grid.seeds)
            )
        }
        modules = {name: each.build(channels, queries) for name, each in members.items()}
        rates = {name: each.learning_rate for name, each in members.items()}
        part = f"{kind}-{layer}" if layer is not None else kind
        save_to = None if folder is None else folder / f"{part}.json"
        fits = train_readouts(
            modules, rates, examples.train, examples.held_out, how, seed, save_to, progress
        )
        trained += [TrainedReadout(members[n], modules[n].eval(), fits[n]) for n in members]
    return trained


def best_of(kind: str, trained: Sequence[TrainedReadout]) -> TrainedReadout:
    """The readout of a kind with the smallest held-out error."""
    return min((t for t in trained if t.candidate.kind == kind), key=_error)


def _error(trained: TrainedReadout) -> float:
    return trained.fit.held_out_error
