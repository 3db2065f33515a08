"""Frames with known positions: of clips, joined, and moved about."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor

from encoders.features import FeatureMap
from vidphys.data.room import room


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


def joined(
    parts: Iterable[LabelledFrames], count: int, folder: Path | None = None
) -> LabelledFrames:
    """Frames of the same grid in one, channels last: single cells are read fastest.

    Args:
        parts: looked at once, one after the other.
        count: frames of all.
        folder: where they lie if they are many; see :func:`vidphys.data.room.room`.
    """
    at = 0
    for part in parts:
        if not at:
            # room for all at once: small tensors that are kept, one between two large ones that
            # are not, would keep the memory of the large ones from being used again
            (_, c, h, w), dtype, centres = part.values.shape, part.values.dtype, part.centres
            values = room((count, h, w, c), dtype, folder).movedim(-1, 1)
            targets = part.targets.new_empty((count, *part.targets.shape[1:]))
            weight = part.weight.new_empty((count, *part.weight.shape[1:]))
        here = slice(at, at := at + len(part))
        values[here], targets[here], weight[here] = part.values, part.targets, part.weight
    return LabelledFrames(values, centres, targets, weight)
