"""Clips as folders of pictures, a frame each: ``bear/00000.jpg``, ``bear/00001.jpg``, ...

The clip of a folder is called ``bear/0``. The order is that of the numbers in the names; nothing
tells the times, so the frames per second have to be given.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.formats.bounded import MOST_BYTES
from vidphys.data.sets.base import MOST_CLIPS, SetFormat
from vidphys.data.sets.sources import pictures
from vidphys.errors import InputError

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
FEWEST = 3  # pictures of a clip, numbered
NAME = "0"  # of the clip of a folder
LOOKED_AT = 200  # entries of a folder that tell whether it is of this kind
MOST_PICTURES = 10**6


def looks(path: Path) -> bool:
    """Whether a folder holds numbered pictures and nothing else, or such folders alone."""
    if not path.is_dir():
        return False
    files, folders = _entries(path)
    if files:
        return _numbered(files)
    return bool(folders) and all(_numbered(_entries(folder)[0]) for folder in folders[:FEWEST])


def _entries(folder: Path) -> tuple[list[str], list[Path]]:
    """Names of the first files, and the first folders."""
    with os.scandir(folder) as entries:
        some = [e for e in islice(entries, LOOKED_AT) if not e.name.startswith(".")]
        return [e.name for e in some if e.is_file()], [folder / e.name for e in some if e.is_dir()]


def _numbered(names: Sequence[str]) -> bool:
    shown = [name for name in names if name.lower().endswith(SUFFIXES)]
    return len(shown) == len(names) >= FEWEST and all(re.search(r"\d", n) for n in shown)


def read(path: Path) -> Dataset:
    """The clips of a folder."""
    clips: dict[Path, list[Path]] = {}
    for folder in (path, *sorted(each for each in path.iterdir() if each.is_dir())):
        found = _in_order(folder)
        clips |= {folder / NAME: found} if found else {}
        if len(clips) > MOST_CLIPS:
            raise InputError(f"more than {MOST_CLIPS} clips")
    files = tuple(
        ClipFile(name, source=pictures(_loading(shown), np.full(len(shown), np.nan)))
        for name, shown in clips.items()
    )
    return Dataset(files, stored=tuple(each for shown in clips.values() for each in shown))


def _in_order(folder: Path) -> list[Path]:
    """The pictures of a folder, by the numbers in their names: 2 before 10."""
    shown = [each for each in folder.iterdir() if each.name.lower().endswith(SUFFIXES)]
    if len(shown) > MOST_PICTURES:
        raise InputError(f"{folder}: more than {MOST_PICTURES} pictures")
    return sorted(shown, key=lambda each: ([int(n) for n in re.findall(r"\d+", each.stem)], each))


def _loading(shown: Sequence[Path]) -> Callable[[], Iterator[bytes]]:
    def load() -> Iterator[bytes]:
        for each in shown:
            if each.stat().st_size > MOST_BYTES:
                raise InputError(f"{each} has more than {MOST_BYTES >> 20} MiB")
            yield each.read_bytes()

    return load


PICTURES = SetFormat(looks, read)
