"""Training a readout that reads positions twice: the rough one, the one near by, and the doubt."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from torch import Generator, Tensor

from readouts.local import LocalReadout, RefinedReadout, blocks, nearest_cells
from vidphys.data.labelled import LabelledFrames, joined
from vidphys.placement import CPU, device_of, moved
from vidphys.progress import Progress
from vidphys.training.early_stopping import BestWeights
from vidphys.training.learner import FitSettings, Learner
from vidphys.training.loop import fit, fit_together
from vidphys.training.readouts import (
    SCORED_AT_ONCE,
    ReadoutFit,
    ReadoutSettings,
    doubt_error,
    mean_distance,
    read_all,
    softened,
    train_readout,
)

PARTS = 9  # one of so many parts of the steps trains the attention, the others what reads near by
DOUBT = FitSettings(300, 512, 3e-3, 1.0)


def train_refined(
    readout: RefinedReadout,
    train: LabelledFrames,
    held_out: LabelledFrames,
    settings: ReadoutSettings,
    seed: int,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> ReadoutFit:
    """Fit a readout in place; the part near by looks from where attention does, or else beside it.

    What error to expect is learned on the held-out frames: on the others, errors are smaller than
    they will be.

    Args:
        readout: see :class:`RefinedReadout`.
        train, held_out: see :func:`vidphys.training.readouts.train_readouts`.
        settings: of the whole training; see :data:`PARTS`. The attention's maps are moved.
        seed: of the batch order and of where is looked.
        folder: for the checkpoints of its parts.
        progress: called as ``(step, steps, loss)``.

    Raises:
        FloatingPointError: the training was lost.
    """
    fit_, block = settings.fit, readout.block
    save = {name: folder and folder / f"{name}.json" for name in ("coarse", "fine", "doubt")}
    coarse = replace(fit_, steps=max(1, fit_.steps // PARTS))
    fine = replace(fit_, steps=max(1, fit_.steps - coarse.steps))
    rough = _rough(readout, train, folder), _rough(readout, held_out, folder)
    moved = replace(settings, fit=coarse, cells=settings.cells // block)
    train_readout(readout.coarse, *rough, moved, seed, save["coarse"], progress)
    found, _ = read_all(readout.coarse, rough[0].values, rough[0].centres)
    error = partial(mean_distance, readout, held_out)
    best = BestWeights(readout.local, error, fine.steps, settings.stop)
    learner = Learner(readout.local, partial(_missed, readout.local), fine, best)
    glances = Glances(readout.local, train, found, Generator().manual_seed(seed))
    fit_together([learner], glances, seed, save["fine"], progress)
    best.restore()
    _fit_doubt(readout, held_out, seed, save["doubt"])
    return ReadoutFit(best.error, best.step, learner.step, learner.loss)


def _rough(readout: RefinedReadout, frames: LabelledFrames, folder: Path | None) -> LabelledFrames:
    """The frames as attention reads them."""
    if readout.block == 1:
        return frames
    return joined(_averaged(readout.block, frames), len(frames), folder)


def _averaged(block: int, frames: LabelledFrames) -> Iterator[LabelledFrames]:
    for begin in range(0, len(frames), SCORED_AT_ONCE):
        some = frames[begin : begin + SCORED_AT_ONCE]
        values, centres = blocks(some.values, some.centres, block)
        yield replace(some, values=values.to(some.values.dtype), centres=centres)


@dataclass(frozen=True)
class Glance:
    """What is read near by of some frames: the cells around a place for each target, no more.

    Args:
        seen: their features, ``(f, n, k, k, c)``.
        cells: (row, column) of the middle one, ``(f, n, 2)``.
        centres, targets, weight: see :class:`LabelledFrames`.
    """

    seen: Tensor
    cells: Tensor
    centres: Tensor
    targets: Tensor
    weight: Tensor


class Glances:
    """Frames seen from where attention finds the bodies, or as often from beside the true places.

    Attention knows its training frames better than others, hence the half a cell or less beside
    the truth; but only it shows how far off a hidden body will be looked for.

    Args:
        local: whose cells are cut out.
        frames: channels last in memory are cut many times faster.
        found: where attention finds the bodies, ``(f, n, 2)``, normalised image units.
        rng: of where is looked.
    """

    def __init__(
        self, local: LocalReadout, frames: LabelledFrames, found: Tensor, rng: Generator
    ) -> None:
        self.local, self.frames, self.found, self.rng = local, frames, found, rng

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: Tensor) -> Glance:
        whole = self.frames
        targets = whole.targets[index]
        noise = torch.rand(targets.shape, generator=self.rng, dtype=targets.dtype)
        beside = targets + whole.cell * (noise - 0.5)
        either = torch.rand(len(index), 1, 1, generator=self.rng) < 0.5
        near = torch.where(either, self.found[index], beside)
        cells = nearest_cells(near, whole.centres)
        seen = self.local.cut(whole.values, index, cells)
        return Glance(seen, cells, whole.centres, targets, whole.weight[index])


def _missed(local: LocalReadout, glance: Glance) -> Tensor:
    """Softened distances from the true places: each reader's, so that all learn for themselves."""
    positions, _ = local.read(glance.seen, glance.cells, glance.centres)
    distance = softened((positions - glance.targets).square().sum(-1)).sum(0)
    return (glance.weight * distance).sum() / glance.weight.sum().clamp_min(1e-12)


@dataclass(frozen=True)
class Judged:
    """Positions that were read, each by itself: ``(m, k)`` what they are judged by, ``(m,)``."""

    evidence: Tensor
    distance: Tensor
    weight: Tensor

    def __len__(self) -> int:
        return len(self.distance)

    def __getitem__(self, index: Tensor) -> Judged:
        return Judged(self.evidence[index], self.distance[index], self.weight[index])


def _fit_doubt(
    readout: RefinedReadout, frames: LabelledFrames, seed: int, save_to: Path | None
) -> None:
    with torch.no_grad():
        given = ((v, frames.centres) for v in frames.values.split(SCORED_AT_ONCE))
        looks = [moved(readout.look(*moved(x, device_of(readout))), CPU) for x in given]
    positions, evidence = (torch.cat(each) for each in zip(*looks, strict=True))
    distance = (positions - frames.targets).norm(dim=-1)
    judged = Judged(evidence.flatten(0, 1), distance.flatten(), frames.weight.flatten())

    def loss(batch: Judged) -> Tensor:
        wrong = doubt_error(readout.expected(batch.evidence), batch.distance)
        return (batch.weight * wrong).sum() / batch.weight.sum().clamp_min(1e-12)

    fit(readout.doubt, loss, judged, DOUBT, seed, save_to)
