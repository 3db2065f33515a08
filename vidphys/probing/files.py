"""Clips on disk, of every kind that is trained on, with what is known of each."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import torch

from vidphys.data.about import about_video
from vidphys.data.ahead import ahead
from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.dataset import find_dataset
from vidphys.data.labels import read_columns, read_places
from vidphys.data.resampling import in_step
from vidphys.data.splits import AUTO, TIME, groups_of
from vidphys.data.video import ClipSelection, Video, open_video
from vidphys.errors import InputError
from vidphys.probing.catalogue import TARGETS
from vidphys.probing.examples import labelled_frames
from vidphys.probing.known import Bodies, Known, numbered
from vidphys.probing.shown import AT_ONCE, Block
from vidphys.probing.targets import Labels, Target, labels_of
from vidphys.probing.truth import Track, Truth
from vidphys.runs.atomic import sha256

KEPT_BYTES = 2**29  # of decoded frames, which are decoded again where they are more
UNEVEN = "each is seen at the time that it has"


@dataclass(frozen=True)
class Opened:
    """A clip that was opened.

    Args:
        whole: all its frames that are selected.
        shown: those of them that are shown.
    """

    whole: Video
    shown: Video

    @property
    def released(self) -> Opened:
        """Without the frames in memory."""
        videos = (replace(v, frames=v.frames.released) for v in (self.whole, self.shown))
        return Opened(*videos)


@dataclass(frozen=True)
class Files:
    """Clips on disk.

    Args:
        path: a folder of clips, or a data set; see :func:`vidphys.data.dataset.find_dataset`.
        selection: the frames of each clip.
        each: frames of each clip that are read.
        columns: pairs of what a column of their tables is and its name, where that does not tell.
        resample: take the frames nearest to so many a second, of clips whose frames come unevenly.
        split_by: what stays together in the folds; see :func:`vidphys.data.splits.groups_of`.
    """

    path: Path
    selection: ClipSelection
    each: int
    columns: tuple[tuple[str, str], ...] = ()
    resample: float | None = None
    split_by: str = AUTO

    @cached_property
    def dataset(self) -> Dataset:
        """The clips.

        Raises:
            InputError: no clips, or nothing that is known of them.
        """
        if self.split_by == TIME:
            raise InputError("`split_by` time: clips are tested whole; name a fact, or leave it")
        found = find_dataset(self.path, dict(self.columns))
        if self.columns and not found.labelled:
            raise InputError(
                f"`columns`: would have no effect: {self.path} has no tables of positions; leave it"
                " away"
            )
        if not any(file.labels or file.truth or file.facts for file in found.files):
            raise InputError(
                f"{self.path}: nothing is known of its clips; a probe learns from a table beside "
                "each (NAME.csv, NAME.parquet, NAME.json, with a row for each frame), or from a "
                "data set"
            )
        return found

    @property
    def count(self) -> int:
        return len(self.dataset.files)

    def blocks(self) -> Iterator[Block]:
        kept = self._decoded_once[1]
        yield from self._decoded([]) if kept is None else kept

    @property
    def hashes(self) -> tuple[str, ...]:
        """SHA-256 of every file, also of those that tell what is known."""
        truths = (file.truth for file in self.dataset.files)
        beside = (sha256(truth.path) for truth in truths if truth and truth.path)
        own = self.dataset.hashes
        return (*(own[name] for name in sorted(own)), *beside)

    @property
    def fingerprints(self) -> tuple[str, ...]:
        """Of each clip, a hash of its content and of the frames and times that are shown."""
        videos = (opened.shown for opened in self._opened)
        words = (f"{v.sha256} {v.indices.tolist()} {v.times.tolist()} {v.size}" for v in videos)
        return tuple(hashlib.sha256(each.encode()).hexdigest() for each in words)

    def known(self, targets: Sequence[str]) -> Known:
        """See :class:`vidphys.probing.shown.Shown`; all of the catalogue where none is named.

        Raises:
            InputError: a table that cannot be read, a target that was named and cannot be had, or
                a clip that is in two groups.
        """
        files = self.dataset.files
        paths = [str(file.path) for file in files]
        hashes = [opened.whole.sha256 for opened in self._opened]
        groups = numbered(paths, hashes, groups_of(files, self.split_by))
        work = [partial(self._truth, *each) for each in zip(files, self._opened, strict=True)]
        truths = [*ahead(work)]
        labels, left_out = self._labels(truths, targets)
        about = tuple(about_video(opened.shown, UNEVEN) for opened in self._opened)
        columns = tuple(name for name in truths[0].columns if name not in ("time", "coupling"))
        return Known(labels, left_out, groups, self._bodies(truths), about, columns)

    @property
    def _opened(self) -> list[Opened]:
        return self._decoded_once[0]

    @cached_property
    def _decoded_once(self) -> tuple[list[Opened], list[Block] | None]:
        """Every clip, and all frames where they are few: decoding costs a process each."""
        opened: list[Opened] = []
        kept: list[Block] | None = []
        size = 0
        for block in self._decoded(opened):
            size += block.frames.nbytes
            kept = None if kept is None or size > KEPT_BYTES else [*kept, block]
        return opened, kept

    def _decoded(self, found: list[Opened]) -> Iterator[Block]:
        """All clips a few at a time; each is added to ``found``."""
        waiting: list[Video] = []
        for opened in ahead([partial(self._open, file) for file in self.dataset.files]):
            found.append(opened.released)
            video = opened.shown
            if video.size != found[0].shown.size:
                raise InputError(
                    f"{video.path}: frame size {video.size}, but {found[0].shown.path.name} has "
                    f"{found[0].shown.size}; the clips of a data set are alike"
                )
            if waiting and (
                len(waiting) == AT_ONCE or not np.array_equal(video.times, waiting[0].times)
            ):
                yield self._block(waiting)
                waiting = []
            waiting.append(video)
        yield self._block(waiting)

    def _open(self, file: ClipFile) -> Opened:
        whole = open_video(file.path, self.selection)
        return Opened(whole, in_step(whole, self.resample, self.selection.stride))

    def _block(self, videos: Sequence[Video]) -> Block:
        frames = torch.from_numpy(np.stack([np.asarray(video.frames) for video in videos]))
        times = torch.from_numpy(videos[0].times)
        return Block(frames.movedim(-1, 2), times, self._read(videos[0]))

    def _read(self, video: Video) -> tuple[int, ...]:
        return labelled_frames(len(video.times), self.each)

    def _truth(self, file: ClipFile, opened: Opened) -> Truth:
        """What is known of a clip in all frames that are selected."""
        video, given = opened.whole, dict(self.columns)
        masses = {f"m{k + 1}": mass for k, mass in enumerate(file.mass or ())}
        alike = {"coupling": file.coupling, **masses, **file.facts}
        columns = {name: np.array([x] * len(video.times)) for name, x in alike.items()}
        for source in (file.labels, file.truth):
            if source is not None:
                columns |= read_columns(source, video, self.selection, given)
        source = file.labels or file.truth
        if source is None:
            return Truth(video.times, columns)
        half = self.dataset.half_extent
        try:
            places = half * read_places(source, video, self.selection, half, given)
        except InputError as error:
            return Truth(video.times, columns, why_not=str(error))
        return Truth(video.times, columns, places)

    def _labels(
        self, truths: Sequence[Truth], targets: Sequence[str]
    ) -> tuple[tuple[Labels, ...], dict[str, str]]:
        found, left_out = [], {}
        for name in targets or [name for name in TARGETS if ":" not in name]:
            try:
                labels = self._values(TARGETS[name], truths)
            except ValueError as error:
                why = str(error)
            else:
                why = labels.why_not
            if why and name in targets:
                raise InputError(f"{self.path}: target {name}: {why}")
            if why:
                left_out[name] = why
            else:
                found.append(labels)
        return tuple(found), left_out

    def _values(self, target: Target, truths: Sequence[Truth]) -> Labels:
        """In the frames that are read; what is the same in all frames of a clip is the clip's."""
        whole = [target.read(truth) for truth in truths]
        widths = sorted({values.shape[1] for values in whole})
        if len(widths) > 1:
            raise ValueError(
                f"some clips have {widths[0]} numbers of it and some {widths[-1]}; the clips of a "
                "data set are alike"
            )
        still = target.per == "frame" and all((v == v[:1]).all() for v in whole)
        values = np.concatenate(
            [v[self._rows(o)] for v, o in zip(whole, self._opened, strict=True)]
        )
        return labels_of(target.name, target.kind, "clip" if still else target.per, values)

    def _rows(self, opened: Opened) -> np.ndarray:
        """Numbers of the frames that are read, among those that are selected."""
        read = opened.shown.indices[list(self._read(opened.shown))]
        return np.searchsorted(opened.whole.indices, read)

    def _bodies(self, truths: Sequence[Truth]) -> Bodies | str:
        why = next((truth.why_not for truth in truths if truth.places is None), "")
        if why:
            return why
        if len({truth.positions().shape[1] for truth in truths}) > 1:
            return "the clips have different numbers of bodies"
        rows = [self._rows(opened) for opened in self._opened]
        both = [*zip(truths, rows, self._opened, strict=True)]
        positions = np.concatenate([truth.positions()[row] for truth, row, _ in both])
        times = np.concatenate([truth.times[row] for truth, row, _ in both])
        clips = np.arange(self.count).repeat(self.each)
        shares = np.concatenate(
            [
                truth.positions()[row]
                / self.dataset.half_extent
                * max(opened.whole.size)
                / np.array(opened.whole.size[::-1])
                for truth, row, opened in both
            ]
        )
        return Bodies(Track(positions, times, clips), torch.from_numpy(shares).float())
