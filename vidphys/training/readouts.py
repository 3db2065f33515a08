"""Training position readouts over cached features, from target tracks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor, nn

from readouts.attention import distance_at
from readouts.base import FrameReadout, Readout
from vidphys.data.labelled import LabelledFrames, Shifted
from vidphys.placement import CPU, device_of, moved
from vidphys.progress import Progress
from vidphys.training.early_stopping import BestWeights, StopSettings
from vidphys.training.learner import FitSettings, Learner
from vidphys.training.loop import fit_together

SCORED_AT_ONCE = 64
SOFTENING = 0.003  # normalised image units; the loss is quadratic below and linear above
ROOT_SOFTENING = 1e-4  # normalised image units; a root has no slope at zero


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


def train_readouts(
    readouts: Mapping[str, FrameReadout],
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
        readouts: by name.
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
        readout.fit_scale(train.values)
        error = partial(mean_distance, readout, held_out)
        best = BestWeights(readout, error, settings.fit.steps, settings.stop)
        own = replace(settings.fit, learning_rate=learning_rates[name])
        learners[name] = Learner(readout, _loss(readout), own, best)
    data = Shifted(train, settings.cells)
    fit_together(list(learners.values()), data, seed, save_to, progress)
    found = {}
    for name, learner in learners.items():
        assert learner.best is not None
        learner.best.restore()
        found[name] = ReadoutFit(learner.best.error, learner.best.step, learner.step, learner.loss)
    return found


def train_readout(
    readout: FrameReadout,
    train: LabelledFrames,
    held_out: LabelledFrames,
    settings: ReadoutSettings,
    seed: int,
    save_to: Path | None = None,
    progress: Progress | None = None,
) -> ReadoutFit:
    """Fit one readout in place; see :func:`train_readouts`."""
    rate = {"": settings.fit.learning_rate}
    how = settings, seed, save_to, progress
    return train_readouts({"": readout}, rate, train, held_out, *how)[""]


def mean_distance(readout: Readout, data: LabelledFrames) -> float:
    """Mean weighted distance of a readout's positions from the targets, normalised image units."""
    positions, _ = read_all(readout, data.values, data.centres)
    distance = (positions - data.targets).norm(dim=-1)
    return float((data.weight * distance).sum() / data.weight.sum())


def read_all(readout: Readout, values: Tensor, centres: Tensor) -> tuple[Tensor, Tensor]:
    """Positions ``(f, n, 2)`` and confidence ``(f, n)`` of many frames, a few at a time."""
    with torch.no_grad():
        parts = [_read(readout, v, centres) for v in values.split(SCORED_AT_ONCE)]
    return torch.cat([p for p, _ in parts]), torch.cat([c for _, c in parts])


def _read(readout: Readout, values: Tensor, centres: Tensor) -> tuple[Tensor, Tensor]:
    """Some frames, taken to where the readout is; the answer is on the CPU."""
    device = device_of(readout) if isinstance(readout, nn.Module) else CPU
    return moved(readout.read(*moved((values, centres), device)), CPU)


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


def _loss(readout: Readout) -> Callable[[LabelledFrames], Tensor]:
    def loss(batch: LabelledFrames) -> Tensor:
        positions, confidence = readout.read(batch.values, batch.centres)
        square = (positions - batch.targets).square().sum(-1)
        # what is expected of a position must not bend it
        doubt = doubt_error(distance_at(confidence), square.detach().sqrt())
        total = batch.weight * (softened(square) + doubt)
        return total.sum() / batch.weight.sum().clamp_min(1e-12)

    return loss
