"""Training position readouts over cached features, from target tracks."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, cast

import torch
from torch import Generator, Tensor, nn

from encoders.features import FeatureMap
from vidphys.seeding import derive
from vidphys.train import FitSettings, Progress, fit

EVALUATIONS = 40
SCORED_AT_ONCE = 64
SOFTENING = 0.003  # normalised image units; the loss is quadratic below and linear above


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

    def __getitem__(self, index: Tensor) -> LabelledFrames:
        return LabelledFrames(
            self.values[index], self.centres, self.targets[index], self.weight[index]
        )


class Shifted:
    """Labelled frames, each batch moved by a random whole number of cells with its targets.

    Few labelled frames show few places; a frozen encoder's cells look alike everywhere, so moving
    the map teaches the others. Cells from beyond the border repeat the border; a target that
    leaves the image loses its weight.

    Args:
        frames: what is moved.
        cells: largest move, in cells, along both axes.
        seed: of the moves.
    """

    def __init__(self, frames: LabelledFrames, cells: int, seed: int) -> None:
        self.frames, self.cells = frames, cells
        self.rng = Generator().manual_seed(derive(seed, "shift"))

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: Tensor) -> LabelledFrames:
        batch = self.frames[index]
        span = (-self.cells, self.cells + 1)
        down, right = torch.randint(*span, (2,), generator=self.rng).tolist()
        return shift(batch, down, right)


def shift(batch: LabelledFrames, down: int, right: int) -> LabelledFrames:
    """Move features and targets by whole cells."""
    h, w = batch.values.shape[-2:]
    rows = (torch.arange(h) - down).clamp(0, h - 1)
    columns = (torch.arange(w) - right).clamp(0, w - 1)
    cell = _cell(batch.centres)
    targets = batch.targets + cell * torch.tensor([right, -down], dtype=cell.dtype)
    border = batch.centres.abs().amax((0, 1)) + cell / 2
    inside = (targets.abs() <= border).all(-1)
    values = batch.values[:, :, rows][..., columns]
    return LabelledFrames(values, batch.centres, targets, batch.weight * inside)


def _cell(centres: Tensor) -> Tensor:
    """(width, height) of a cell, normalised image units."""
    h, w = centres.shape[:2]
    if min(h, w) < 2:
        raise ValueError(f"shift: needs a grid of at least 2 x 2 cells, got {h} x {w}")
    return (centres[1, 1] - centres[0, 0]).abs()


@dataclass(frozen=True)
class ReadoutFit:
    """What the training leaves in the record.

    Args:
        held_out_error: mean distance from the targets with the weights that were kept,
            normalised image units.
        kept_step: optimiser step at which they were the weights.
        steps: that were taken.
        train_loss: of the last batch.
    """

    held_out_error: float
    kept_step: int
    steps: int
    train_loss: float


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


def train_readout(
    readout: nn.Module,
    train: LabelledFrames,
    held_out: LabelledFrames,
    settings: FitSettings,
    seed: int,
    cells: int = 0,
    progress: Progress | None = None,
) -> ReadoutFit:
    """Fit a readout in place; the weights that are best on the held-out frames are kept.

    Args:
        readout: a module that is a :class:`PositionReadout`.
        train: frames to learn from; see :class:`LabelledFrames`.
        held_out: frames that decide which weights are kept.
        settings: of the optimiser.
        seed: of the batch order and the moves.
        cells: move training maps at random by up to so many cells; see :class:`Shifted`.
        progress: called as ``(step, steps, loss)``.

    Raises:
        ValueError: no frames to train on or to hold out.
    """
    if len(train) == 0 or len(held_out) == 0:
        raise ValueError(
            f"train_readout: needs frames to train on and to hold out, got {len(train)} and "
            f"{len(held_out)}"
        )
    reader = cast(PositionReadout, readout)
    reader.fit_scale(train.values)
    best = _Best(readout, held_out, every=max(1, settings.steps // EVALUATIONS))

    def follow(step: int, steps: int, loss: float) -> None:
        best.look(step, last=step == steps)
        if progress is not None:
            progress(step, steps, loss)

    data = Shifted(train, cells, seed) if cells else train
    result = fit(readout, _loss(reader), data, settings, seed, progress=follow)
    readout.load_state_dict(best.weights)
    return ReadoutFit(best.error, best.step, result.steps, result.final_loss)


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


def _loss(reader: PositionReadout) -> Callable[[LabelledFrames], Tensor]:
    def loss(batch: LabelledFrames) -> Tensor:
        positions, _ = reader.read(batch.values, batch.centres)
        square = (positions - batch.targets).square().sum(-1)
        # the distance, not its square: a few blurred frames would rule the others
        distance = (square + SOFTENING**2).sqrt() - SOFTENING
        return (batch.weight * distance).sum() / batch.weight.sum().clamp_min(1e-12)

    return loss


class _Best:
    """The weights with the smallest held-out error so far."""

    def __init__(self, readout: nn.Module, held_out: LabelledFrames, every: int) -> None:
        self.readout, self.held_out, self.every = readout, held_out, every
        self.error, self.step = math.inf, 0
        self.weights = copy.deepcopy(readout.state_dict())

    def look(self, step: int, last: bool) -> None:
        if step % self.every and not last:
            return
        data = self.held_out
        positions, _ = read_all(self.readout, data.values, data.centres)
        distance = (positions - data.targets).norm(dim=-1)
        error = float((data.weight * distance).sum() / data.weight.sum())
        if error < self.error:
            self.error, self.step = error, step
            self.weights = copy.deepcopy(self.readout.state_dict())
