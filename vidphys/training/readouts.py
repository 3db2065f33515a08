"""Training position readouts over cached features, from target tracks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar, cast

import torch
from torch import Tensor, nn

from encoders.features import FeatureMap
from readouts.attention import distance_at
from vidphys.training.early_stopping import BestWeights, StopSettings
from vidphys.training.learner import FitSettings, Learner
from vidphys.training.loop import Progress, fit_together

SCORED_AT_ONCE = 64
SOFTENING = 0.003  # normalised image units; the loss is quadratic below and linear above
ROOT_SOFTENING = 1e-4  # normalised image units; a root has no slope at zero


class PositionReadout(Protocol):
    """What can be trained here: :mod:`readouts.attention`, :mod:`readouts.pooled`."""

    def fit_scale(self, values: Tensor) -> None: ...

    def read(self, values: Tensor, centres: Tensor) -> tuple[Tensor, Tensor]: ...


@dataclass(frozen=True)
class LabelledFrames:
    """Frames with known positions.

    Args:
        values: features ``(f, c, h, w)``, of any float type (memory-mapped is fine).
        centres: of the cells, normalised image units, ``(h, w, 2)``.
        targets: ``(f, n, 2)``, normalised image units.
        weight: of each target, ``(f, n)``.
    """

    values: Tensor
    centres: Tensor
    targets: Tensor
    weight: Tensor

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, index: Tensor | slice) -> LabelledFrames:
        return LabelledFrames(
            self.values[index], self.centres, self.targets[index], self.weight[index]
        )

    @property
    def grid(self) -> tuple[int, int]:
        """Cells (height, width)."""
        return self.centres.shape[0], self.centres.shape[1]

    @property
    def cell(self) -> Tensor:
        """(width, height) of a cell, normalised image units.

        Raises:
            ValueError: fewer than two cells on a side.
        """
        h, w = self.grid
        if min(h, w) < 2:
            raise ValueError(f"readout: needs a grid of at least 2 x 2 cells, got {h} x {w}")
        return (self.centres[1, 1] - self.centres[0, 0]).abs()


class Shifted:
    """Labelled frames, each moved by a whole number of cells with its targets.

    Few labelled frames show few places; a frozen encoder's cells look alike everywhere, so moving
    the map teaches the others. An example is a frame under one of the moves, so that the batch
    order alone decides what is seen.

    Args:
        frames: what is moved.
        cells: largest move, in cells, along both axes.
    """

    def __init__(self, frames: LabelledFrames, cells: int) -> None:
        self.frames, self.cells = frames, cells

    def __len__(self) -> int:
        return len(self.frames) * (2 * self.cells + 1) ** 2

    def __getitem__(self, index: Tensor) -> LabelledFrames:
        batch = self.frames[index % len(self.frames)]
        if not self.cells:
            return batch
        move, span = index // len(self.frames), 2 * self.cells + 1
        return shift(batch, move // span - self.cells, move % span - self.cells)


Frames = TypeVar("Frames", bound=LabelledFrames)


def shift(batch: Frames, down: Tensor, right: Tensor) -> Frames:
    """Move features and targets by whole cells, ``(f,)`` each.

    Cells from beyond the border repeat the border; a target that leaves the image loses its
    weight.
    """
    h, w = batch.values.shape[-2:]
    rows = (torch.arange(h) - down[:, None]).clamp(0, h - 1)
    columns = (torch.arange(w) - right[:, None]).clamp(0, w - 1)
    frame = torch.arange(len(batch))[:, None, None]
    cells = batch.values.movedim(1, -1)[frame, rows[:, :, None], columns[:, None, :]]
    size = batch.cell
    targets = batch.targets + size * torch.stack([right, -down], -1).to(size)[:, None]
    border = batch.centres.abs().amax((0, 1)) + size / 2
    inside = (targets.abs() <= border).all(-1)
    values = cells.movedim(-1, 1)
    return replace(batch, values=values, targets=targets, weight=batch.weight * inside)


@dataclass(frozen=True)
class ReadoutFit:
    """What the training leaves in the record.

    Args:
        held_out_error: mean distance from the targets with the weights that were kept,
            normalised image units; infinite where the training was lost.
        kept_step: optimiser step at which they were the weights.
        steps: that were taken.
        train_loss: of the last batch.
    """

    held_out_error: float
    kept_step: int
    steps: int
    train_loss: float


@dataclass(frozen=True)
class ReadoutSettings:
    """How readouts are trained.

    Args:
        fit: of the optimiser; each readout has a learning rate of its own.
        cells: move training maps at random by up to so many cells; see :class:`Shifted`.
        stop: when the held-out frames are looked at, and when they end the training.
    """

    fit: FitSettings
    cells: int = 0
    stop: StopSettings = StopSettings()


def labelled_frames(features: FeatureMap, targets: Tensor, weight: Tensor) -> LabelledFrames:
    """All frames of a batch of clips with targets ``(b, t, n, 2)`` and weights ``(b, t, n)``.

    Raises:
        ValueError: features and targets of another number of frames.
    """
    if features.values.shape[:2] != targets.shape[:2]:
        raise ValueError(
            f"labelled_frames: features of {tuple(features.values.shape[:2])} (clips, frames), "
            f"targets of {tuple(targets.shape[:2])}; they must be the same frames"
        )
    return LabelledFrames(
        features.values.flatten(0, 1),
        features.cell_centres(),
        targets.flatten(0, 1),
        weight.flatten(0, 1),
    )


def joined(parts: Sequence[LabelledFrames]) -> LabelledFrames:
    """Frames of the same grid in one, in memory, channels last: single cells are read fastest."""
    count, first = sum(map(len, parts)), parts[0]
    values = torch.empty(
        (count, *first.values.shape[1:]),
        dtype=first.values.dtype,
        memory_format=torch.channels_last,
    )
    torch.cat([part.values for part in parts], out=values)
    targets = torch.cat([part.targets for part in parts])
    return LabelledFrames(values, first.centres, targets, torch.cat([p.weight for p in parts]))


def train_readouts(
    readouts: Mapping[str, nn.Module],
    learning_rates: Mapping[str, float],
    train: LabelledFrames,
    held_out: LabelledFrames,
    settings: ReadoutSettings,
    seed: int,
    save_to: Path | None = None,
    progress: Progress | None = None,
) -> dict[str, ReadoutFit]:
    """Fit readouts in place, all on the same batches, each of which is read once.

    Each is left with the weights that were its best on the held-out frames, and is what it would
    have become alone.

    Args:
        readouts: modules that are a :class:`PositionReadout`, by name.
        learning_rates: of each, in place of the settings'.
        train: frames to learn from; see :class:`LabelledFrames`.
        held_out: frames that decide which weights are kept.
        settings: see :class:`ReadoutSettings`.
        seed: of the batch order and the moves.
        save_to: JSON path of the checkpoint, from which an interrupted training goes on.
        progress: called as ``(step, steps, loss)``.

    Raises:
        ValueError: no frames to train on or to hold out.
        FloatingPointError: every training was lost.
    """
    if len(train) == 0 or len(held_out) == 0:
        raise ValueError(
            f"train_readouts: needs frames to train on and to hold out, got {len(train)} and "
            f"{len(held_out)}"
        )
    learners = {}
    for name, readout in readouts.items():
        reader = cast(PositionReadout, readout)
        reader.fit_scale(train.values)
        error = partial(mean_distance, readout, held_out)
        best = BestWeights(readout, error, settings.fit.steps, settings.stop)
        own = replace(settings.fit, learning_rate=learning_rates[name])
        learners[name] = Learner(readout, _loss(reader), own, best)
    data = Shifted(train, settings.cells)
    fit_together(list(learners.values()), data, seed, save_to, progress)
    found = {}
    for name, learner in learners.items():
        assert learner.best is not None
        learner.best.restore()
        found[name] = ReadoutFit(learner.best.error, learner.best.step, learner.step, learner.loss)
    return found


def train_readout(
    readout: nn.Module,
    train: LabelledFrames,
    held_out: LabelledFrames,
    settings: ReadoutSettings,
    seed: int,
    progress: Progress | None = None,
) -> ReadoutFit:
    """Fit one readout in place; see :func:`train_readouts`."""
    rate = {"": settings.fit.learning_rate}
    return train_readouts({"": readout}, rate, train, held_out, settings, seed, progress=progress)[
        ""
    ]


def mean_distance(readout: nn.Module, data: LabelledFrames) -> float:
    """Mean weighted distance of a readout's positions from the targets, normalised image units."""
    positions, _ = read_all(readout, data.values, data.centres)
    distance = (positions - data.targets).norm(dim=-1)
    return float((data.weight * distance).sum() / data.weight.sum())


def read_all(readout: nn.Module, values: Tensor, centres: Tensor) -> tuple[Tensor, Tensor]:
    """Positions ``(f, n, 2)`` and confidence ``(f, n)`` of many frames, a few at a time."""
    reader = cast(PositionReadout, readout)
    with torch.no_grad():
        parts = [reader.read(v, centres) for v in values.split(SCORED_AT_ONCE)]
    return torch.cat([p for p, _ in parts]), torch.cat([c for _, c in parts])


def position_rmse(positions: Tensor, targets: Tensor, weight: Tensor) -> float:
    """Root of the mean squared distance, per body and frame, weighted; the targets' unit."""
    square = (positions - targets).square().sum(-1)
    return float((weight * square).sum() / weight.sum()) ** 0.5


def softened(square: Tensor) -> Tensor:
    """The distance, not its square, so that a few blurred frames do not rule the others."""
    return (square + SOFTENING**2).sqrt() - SOFTENING


def doubt_error(expected: Tensor, distance: Tensor) -> Tensor:
    """How wrong an expected distance is: of roots, so that a few large ones do not rule."""
    root = (distance.detach() + ROOT_SOFTENING).sqrt()
    return ((expected + ROOT_SOFTENING).sqrt() - root).square()


def _loss(reader: PositionReadout) -> Callable[[LabelledFrames], Tensor]:
    def loss(batch: LabelledFrames) -> Tensor:
        positions, confidence = reader.read(batch.values, batch.centres)
        square = (positions - batch.targets).square().sum(-1)
        # what is expected of a position must not bend it
        doubt = doubt_error(distance_at(confidence), square.detach().sqrt())
        total = batch.weight * (softened(square) + doubt)
        return total.sum() / batch.weight.sum().clamp_min(1e-12)

    return loss
