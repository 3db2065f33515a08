"""Clips in units of work, without a list of all: shards of WebDataset, and slices of all else."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import zlib
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from vidphys.data.dataset import clips_of
from vidphys.data.formats import ClipFormat, format_of
from vidphys.data.listed import clips_at
from vidphys.data.sets import set_of
from vidphys.data.sets.folder import MANIFEST
from vidphys.data.sets.shards import SHARD, shards_in
from vidphys.errors import InputError

SLICE = 256  # clips in a unit, but for a shard, which is one whole


class Units:
    """Units of work that lie in a file, a line each, of which one is read at a time.

    Args:
        path: as :func:`write_units` wrote it.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._places, self._sums = path, array("q", [0]), array("L")
        with path.open("rb") as file:
            for line in file:
                self._places.append(self._places[-1] + len(line))
                self._sums.append(zlib.crc32(line))

    def __len__(self) -> int:
        return len(self._places) - 1

    def __getitem__(self, number: int) -> list[Path]:
        """The clips of a unit; those of a shard are looked up in it.

        Raises:
            InputError: the shard is gone or damaged.
            OSError: the file was damaged meanwhile.
        """
        if not 0 <= number < len(self):
            raise IndexError(f"unit {number} of {len(self)}")
        with self.path.open("rb") as file:
            file.seek(self._places[number])
            line = file.readline()
        if zlib.crc32(line) != self._sums[number]:
            raise OSError(errno.EIO, "damaged since this work began", str(self.path))
        clips = [Path(name) for name in json.loads(line)]
        return clips_of(clips[0]) if _is_shard(clips[0]) else clips


def write_units(given: Sequence[Path], about: Any, path: Path) -> str:
    """Slice what a command was given into units.

    Args:
        given: see :func:`vidphys.data.listed.listed_clips`. Of a folder only names are held.
        about: what else the result depends on, for the hash.
        path: of the file that is written.

    Returns:
        A hash of ``about`` and of each file's name, size and time of change: workers that see the
        same have the same.

    Raises:
        InputError: nothing is there, or nothing in it is a clip.
    """
    digest = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    with path.open("w", encoding="utf-8") as file:
        for unit in _sliced(given):
            line = json.dumps([os.fspath(clip) for clip in unit]) + "\n"
            file.write(line)
            digest.update(line.encode())
            for clip in unit:
                digest.update(_seen(clip).encode())
    return digest.hexdigest()


def _sliced(given: Sequence[Path]) -> Iterator[list[Path]]:
    """Shards alone; of other clips as many as a slice has."""
    waiting: list[Path] = []
    for clip in (each for place in given for each in _each(place)):
        if _is_shard(clip):
            yield [clip]
            continue
        waiting.append(clip)
        if len(waiting) == SLICE:
            yield waiting
            waiting = []
    if waiting:
        yield waiting


def _each(place: Path) -> Iterator[Path]:
    """Clips and shards; a folder is not looked into further than its names."""
    if place.is_dir() and not (place / MANIFEST).is_file():
        if shards := shards_in(place):
            yield from shards
            return
        if set_of(place) is None:
            with os.scandir(place) as entries:
                names = sorted(e.name for e in entries if format_of(Path(e.path), ClipFormat))
            if names:
                yield from (place / name for name in names)
                return
    if _is_shard(place) and place.is_file():
        yield place
        return
    yield from clips_at(place)


def _is_shard(path: Path) -> bool:
    return path.suffix.lower() == SHARD and path.is_file()


def _seen(clip: Path) -> str:
    """Size and time of change of a clip's file, or of the file that holds it."""
    for path in (clip, *clip.parents):
        try:
            about = path.stat()
        except (FileNotFoundError, NotADirectoryError):
            continue
        return f"{about.st_size} {about.st_mtime_ns}"
    raise InputError(f"extract: {clip}: no such clip")
