"""WebDataset: tar files of samples, whose members share a name up to its first dot.

A sample is a clip, by a film (``KEY.mp4``) or several pictures (``KEY.0001.jpg``); or a frame, by
one picture, and then the samples of one folder of the archive are a clip. ``KEY.json`` beside them
holds columns as long as the clip (its labels and times), single numbers and words (facts), or
COCO's boxes or TAP-Vid's points; ``KEY.cls`` is a fact. The splits are those of shards that begin
with train, val or test.
"""

from __future__ import annotations

import json
import os
import re
import tarfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.formats.bounded import MOST_BYTES, reading
from vidphys.data.formats.coco import boxes_of, is_coco
from vidphys.data.formats.structured import MOST_JSON
from vidphys.data.labels import Labels
from vidphys.data.sets.base import MOST_CLIPS, SetFormat, facts_of, labels_of, times_of
from vidphys.data.sets.sources import encoded, pictures
from vidphys.errors import InputError

SHARD = ".tar"
FILMS = frozenset({"mp4", "avi", "mkv", "webm", "mov"})
PICTURES = frozenset({"jpg", "jpeg", "png", "webp"})
MOST_MEMBERS = 10**6  # of an archive
SPLIT = re.compile(r"(train|val|valid|validation|test)(?=[^a-z]|$)")


@dataclass(frozen=True)
class Member:
    """A file in a tar: where its bytes are."""

    path: Path
    name: str
    offset: int
    size: int

    def __call__(self) -> bytes:
        """The bytes."""
        if self.size > MOST_BYTES:
            raise InputError(f"{self.name!a} has more than {MOST_BYTES >> 20} MiB")
        with self.path.open("rb") as file:
            file.seek(self.offset)
            return file.read(self.size)

    @property
    def ending(self) -> str:
        """Of its name, in lower case."""
        return self.name.rpartition(".")[2].lower()


def looks(path: Path) -> bool:
    """Whether a path is a shard, or a folder of them."""
    return bool(_shards(path))


def shards_in(folder: Path) -> list[Path]:
    """The shards of a folder; of its other entries, which may be millions, nothing is held."""
    with os.scandir(folder) as entries:
        return sorted(folder / e.name for e in entries if e.name.endswith(SHARD) and e.is_file())


def _shards(path: Path) -> list[Path]:
    if path.is_dir():
        return shards_in(path)
    return [path] if path.is_file() and path.suffix.lower() == SHARD else []


def read(path: Path) -> Dataset:
    """The clips of all shards."""
    files: list[ClipFile] = []
    shards = _shards(path)
    for shard in shards:
        root = path / shard.name if path.is_dir() else path
        samples = _samples(shard)
        found = _clips(samples, root, _split(shard))
        files += found
        if len(files) > MOST_CLIPS:
            raise InputError(f"more than {MOST_CLIPS} clips")
    return Dataset(tuple(files), stored=tuple(shards))


def _split(shard: Path) -> str:
    found = SPLIT.match(shard.name.lower())
    return "" if found is None else found[1]


def _samples(shard: Path) -> dict[str, list[Member]]:
    """Members by the name that they share."""
    found: dict[str, list[Member]] = {}
    with reading("a tar archive"), tarfile.open(shard, "r:") as archive:
        for count, member in enumerate(archive):
            if count >= MOST_MEMBERS:
                raise InputError(f"more than {MOST_MEMBERS} files in {shard.name}")
            archive.members = []  # type: ignore[attr-defined] # else it keeps a million of them
            if not member.isreg():
                continue
            name = PurePosixPath(member.name)
            key = str(name.parent / name.name.partition(".")[0])
            one = Member(shard, member.name, member.offset_data, member.size)
            found.setdefault(key, []).append(one)
    return found


def _clips(samples: Mapping[str, Sequence[Member]], root: Path, split: str) -> Iterator[ClipFile]:
    frames: dict[str, list[tuple[Member, Sequence[Member]]]] = {}
    for key, members in samples.items():
        films = [m for m in members if m.ending in FILMS]
        shown = [m for m in members if m.ending in PICTURES]
        if films:
            yield _clip(root / key, members, split, films[0], ())
        elif len(shown) > 1:
            in_order = sorted(shown, key=lambda m: m.name)
            yield _clip(root / key, members, split, None, in_order)
        elif shown:
            frames.setdefault(str(PurePosixPath(key).parent), []).append((shown[0], members))
    for folder, ordered in frames.items():
        yield _of_frames(root / ("0" if folder == "." else folder), ordered, split)


def _clip(
    name: Path, members: Sequence[Member], split: str, film: Member | None, shown: Sequence[Member]
) -> ClipFile:
    held = _held(members)
    lists = {key: x for key, x in held.items() if isinstance(x, list)}
    facts = facts_of(held)
    if film is not None:
        source = encoded(film, f".{film.ending}")
    else:
        source = pictures(_loading(shown), times_of(held, len(shown)))
    return ClipFile(name, _labels(held, lists), facts=facts, split=split, source=source)


def _of_frames(
    name: Path, frames: Sequence[tuple[Member, Sequence[Member]]], split: str
) -> ClipFile:
    ordered = sorted(frames, key=lambda each: each[0].name)
    every = [_held(members) for _, members in ordered]
    changing = {
        key: [held.get(key) for held in every]
        for key, value in every[0].items()
        if isinstance(value, int | float) and any(held.get(key) != value for held in every)
    }
    facts = facts_of({key: x for key, x in every[0].items() if key not in changing})
    times = times_of({**every[0], **changing}, len(ordered))
    source = pictures(_loading([shown for shown, _ in ordered]), times)
    return ClipFile(name, _labels({}, changing), facts=facts, split=split, source=source)


def _loading(members: Sequence[Member]) -> Callable[[], Iterator[bytes]]:
    return lambda: (member() for member in members)


def _held(members: Sequence[Member]) -> dict[str, Any]:
    """What stands beside the pictures of a sample."""
    held: dict[str, Any] = {}
    for member in members:
        ending = member.ending
        if ending == "json":
            if member.size > MOST_JSON:
                raise InputError(f"{member.name!a} has more than {MOST_JSON >> 20} MiB")
            with reading(f"JSON in {member.name!a}"):
                found = json.loads(member())
            held |= found if isinstance(found, dict) else {}
        elif ending in ("cls", "txt") and member.size < 1000:
            text = member().decode(errors="replace").strip()
            held[ending] = int(text) if text.isdecimal() and len(text) < 16 else text
    return held


def _labels(held: Mapping[str, Any], columns: Mapping[str, Any]) -> Labels | None:
    if is_coco(held):
        return Labels("COCO's boxes", partial(boxes_of, held, interval=None))
    return labels_of("the sample's json", columns, lambda: columns) if columns else None


WEBDATASET = SetFormat(looks, read)
