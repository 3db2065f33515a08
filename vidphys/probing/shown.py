"""The clips that an encoder is shown for a probe, and the targets of the frames that are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from vidphys.data.clip_files import ClipFile
from vidphys.data.dataset import find_dataset
from vidphys.data.video import ClipSelection, Video, open_video
from vidphys.errors import InputError
from vidphys.probing.catalogue import TARGETS
from vidphys.probing.examples import labelled_frames
from vidphys.probing.targets import Kind, Labels, Per, Target, labels_of
from vidphys.probing.truth import Track, Truth, read_truth

AT_ONCE = 16  # clips
KEPT_BYTES = 2**29  # of decoded frames, which are decoded again where they are more
DOORS: dict[str, Kind] = {"angle": "circular", "class": "classification", "column": "regression"}


@dataclass(frozen=True)
class Block:
    """Some clips of one size and length.

    Args:
        frames: ``(b, t, 3, H, W)``, bytes or floats in [0, 1].
        times: seconds of each frame, ``(t,)``.
        read: numbers of the frames that are read.
    """

    frames: Tensor
    times: Tensor
    read: tuple[int, ...]


@dataclass(frozen=True)
class About:
    """The frames of one clip: their numbers in the file, seconds, and (height, width)."""

    indices: np.ndarray
    times: np.ndarray
    size: tuple[int, int]


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

    def labels(self, targets: Sequence[str]) -> tuple[list[Labels], dict[str, str]]:
        """Values of targets for the frames that are read; and why there are none, by target."""
        ...

    def places(self) -> Tensor:
        """Of the bodies in each frame that is read, as :class:`Local` wants them.

        Raises:
            ValueError: they are not known.
        """
        ...

    def track(self) -> Track:
        """Likewise, in world units and with their times.

        Raises:
            ValueError: they are not known.
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

    Raises:
        ValueError: arrays of other shapes.
    """

    frames: Tensor
    values: Mapping[str, Any]
    each: int

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

    def labels(self, targets: Sequence[str]) -> tuple[list[Labels], dict[str, str]]:
        found, skipped = [], {}
        for name in targets or self.values:
            labels = self._labels(name)
            if labels.why_not:
                skipped[name] = labels.why_not
            else:
                found.append(labels)
        return found, skipped

    def places(self) -> Tensor:
        raise ValueError("probe: `readout` local: frames alone tell no places; give a folder")

    def track(self) -> Track:
        raise ValueError("probe: `readout` two-stage: frames alone tell no places; give a folder")

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


@dataclass(frozen=True)
class Folder:
    """Clips on disk, each with a table of what is known of it: see :class:`Truth`.

    Args:
        path: a clip's folder, or that of a rendering.
        selection: the frames of each clip.
        each: frames of each clip that are read.
    """

    path: Path
    selection: ClipSelection
    each: int

    @cached_property
    def files(self) -> tuple[ClipFile, ...]:
        """The clips.

        Raises:
            InputError: no clips, or one without a table.
        """
        files = find_dataset(self.path).files
        for file in files:
            if _table(file) is None:
                raise InputError(
                    f"{file.path}: no table beside it; a probe learns from NAME.parquet or "
                    "NAME.csv with a row for each frame"
                )
        return files

    @property
    def count(self) -> int:
        return len(self.files)

    def blocks(self) -> Iterator[Block]:
        kept = self._decoded_once[1]
        yield from self._decoded([]) if kept is None else kept

    @cached_property
    def _decoded_once(self) -> tuple[list[About], list[Block] | None]:
        """About each clip, and all of them where they are small: decoding costs a process each."""
        about: list[About] = []
        kept: list[Block] | None = []
        size = 0
        for block in self._decoded(about):
            size += block.frames.nbytes
            kept = None if kept is None or size > KEPT_BYTES else [*kept, block]
        return about, kept

    def _decoded(self, about: list[About]) -> Iterator[Block]:
        """All clips a few at a time; what is known of each is added to ``about``."""
        waiting: list[Video] = []
        for file in self.files:
            video = open_video(file.path, self.selection)
            about.append(About(video.indices, video.times, video.size))
            if waiting and (
                len(waiting) == AT_ONCE or video.frames.shape != waiting[0].frames.shape
            ):
                yield self._block(waiting)
                waiting = []
            waiting.append(video)
        yield self._block(waiting)

    def labels(self, targets: Sequence[str]) -> tuple[list[Labels], dict[str, str]]:
        """See :class:`Shown`; where none is named, all targets of the catalogue."""
        found, skipped = [], {}
        for name in targets or TARGETS:
            try:
                labels = self._labels(TARGETS[name])
            except ValueError as error:
                why = str(error)
            else:
                why = labels.why_not
            if why and name in targets:
                raise InputError(f"{self.path}: target {name}: {why}")
            if why:
                skipped[name] = why
            else:
                found.append(labels)
        return found, skipped

    def places(self) -> Tensor:
        half_extent = find_dataset(self.path).half_extent
        found = []
        for truth, read, (height, width) in self._truths:
            places = truth.of_bodies("x", "y")[read] / half_extent
            found.append(places * max(height, width) / np.array([width, height]))
        return torch.from_numpy(np.concatenate(found)).float()

    def track(self) -> Track:
        positions = [truth.of_bodies("x", "y")[read] for truth, read, _ in self._truths]
        times = [truth.times[read] for truth, read, _ in self._truths]
        return Track(np.concatenate(positions), np.concatenate(times))

    @cached_property
    def _truths(self) -> list[tuple[Truth, list[int], tuple[int, int]]]:
        """What is known of each clip, the frames that are read, and (height, width)."""
        found = []
        for file, about in zip(self.files, self._decoded_once[0], strict=True):
            table = _table(file)
            assert table is not None
            read = list(labelled_frames(len(about.times), self.each))
            found.append((read_truth(table, about.indices, about.times), read, about.size))
        return found

    def _labels(self, target: Target) -> Labels:
        values = np.concatenate([target.read(truth)[read] for truth, read, _ in self._truths])
        return labels_of(target.name, target.kind, target.per, values)

    def _block(self, videos: Sequence[Video]) -> Block:
        frames = torch.from_numpy(np.stack([video.frames for video in videos]))
        times = torch.from_numpy(videos[0].times)
        return Block(frames.movedim(-1, 2), times, labelled_frames(len(times), self.each))


def _table(file: ClipFile) -> Path | None:
    return file.truth or (None if file.labels is None else file.labels.path)
