"""The clips that an encoder is shown for a probe; here those that are in memory."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from vidphys.data.splits import AUTO, CLIP
from vidphys.probing.examples import labelled_frames
from vidphys.probing.known import Known, numbered
from vidphys.probing.targets import Kind, Labels, Per, labels_of

AT_ONCE = 16  # clips
DOORS: dict[str, Kind] = {"angle": "circular", "class": "classification", "column": "regression"}


@dataclass(frozen=True)
class Block:
    """Some clips of one size, whose frames come at the same times.

    Args:
        frames: ``(b, t, 3, H, W)``, bytes or floats in [0, 1].
        times: seconds of each frame, ``(t,)``.
        read: numbers of the frames that are read.
    """

    frames: Tensor
    times: Tensor
    read: tuple[int, ...]


class Shown(Protocol):
    """Clips, and what is known of the frames that are read."""

    @property
    def count(self) -> int:
        """Clips."""
        ...

    @property
    def each(self) -> int:
        """Frames of each clip that are read."""
        ...

    def blocks(self) -> Iterator[Block]:
        """All clips, in their order, a few at a time."""
        ...

    def known(self, targets: Sequence[str]) -> Known:
        """What is known of the frames that are read.

        Args:
            targets: by name; all that can be had if none is named.
        """
        ...


@dataclass(frozen=True)
class Arrays:
    """Clips in memory.

    Args:
        frames: ``(b, t, 3, H, W)``, bytes or floats in [0, 1].
        values: of each target: ``(b,)`` for each clip, ``(b, t)`` or ``(b, t, k)`` for each frame.
            Integers and words are classes; names may begin with ``angle:`` (radians), ``class:``
            or ``column:`` (numbers).
        each: frames of each clip that are read.
        split_by: a value for each clip; those of one value stay together in the folds.

    Raises:
        ValueError: arrays of other shapes.
    """

    frames: Tensor
    values: Mapping[str, Any]
    each: int
    split_by: str | Sequence[Hashable] = AUTO

    def __post_init__(self) -> None:
        if self.frames.ndim != 5 or self.frames.shape[2] != 3:
            raise ValueError(
                "probe: `clips` must be frames (clips, t, 3, H, W), got "
                f"{tuple(self.frames.shape)}; move the axes there"
            )
        b, t = self.frames.shape[:2]
        for name, values in self.values.items():
            shape = np.shape(values)
            if shape != (b,) and (shape[:2] != (b, t) or len(shape) > 3):
                raise ValueError(
                    f"probe: target {name}: values must be ({b},), ({b}, {t}) or ({b}, {t}, k), "
                    f"got {shape}"
                )
        alone = self.split_by in (AUTO, CLIP)
        if not alone and (isinstance(self.split_by, str) or len(self.split_by) != b):
            raise ValueError(f"probe: `split_by` of frames: must be {b} values, one for each clip")

    @property
    def count(self) -> int:
        return len(self.frames)

    @cached_property
    def read(self) -> tuple[int, ...]:
        """Numbers of the frames that are read."""
        return labelled_frames(self.frames.shape[1], self.each)

    def blocks(self) -> Iterator[Block]:
        times = torch.arange(self.frames.shape[1], dtype=torch.float64)
        for some in self.frames.split(AT_ONCE):
            yield Block(some, times, self.read)

    def known(self, targets: Sequence[str]) -> Known:
        found, left_out = [], {}
        for name in targets or self.values:
            labels = self._labels(name)
            if labels.why_not:
                left_out[name] = labels.why_not
            else:
                found.append(labels)
        names = [f"clip {k}" for k in range(self.count)]
        hashes = [hashlib.sha256(clip.numpy().tobytes()).hexdigest() for clip in self.frames.cpu()]
        alone = isinstance(self.split_by, str)
        groups = numbered(names, hashes, range(self.count) if alone else self.split_by)
        return Known(tuple(found), left_out, groups, "frames alone tell no places; give a folder")

    def _labels(self, name: str) -> Labels:
        values = np.asarray(self.values[name])
        per: Per = "clip" if values.ndim == 1 else "frame"
        whole = values
        if per == "clip":
            whole = values[:, None].repeat(self.frames.shape[1], 1)
        read = whole[:, self.read].reshape(len(values) * self.each, -1)
        door, sign, _ = name.partition(":")
        numbers = np.issubdtype(values.dtype, np.floating)
        kind: Kind = "regression" if numbers else "classification"
        return labels_of(name, DOORS.get(door, kind) if sign else kind, per, read)
