"""Kinds of data sets: each turns a path into clips with what is known of them.

A clip in one is named as if the set were a folder: ``runs.h5/trial 3``.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.sets.arrays import ARRAYS
from vidphys.data.sets.base import SETS, SetFormat, in_plane, labels_of
from vidphys.data.sets.huggingface import HUGGING_FACE
from vidphys.data.sets.lerobot import LEROBOT
from vidphys.data.sets.pictures import PICTURES
from vidphys.data.sets.shards import WEBDATASET
from vidphys.errors import InputError

SETS.register("lerobot", LEROBOT)
SETS.register("huggingface", HUGGING_FACE)
SETS.register("webdataset", WEBDATASET)
SETS.register("arrays", ARRAYS)
SETS.register("pictures", PICTURES)
KEPT = 4  # sets whose list of clips is kept
TOLD = ("meta/info.json", "state.json", "dataset_dict.json")  # what says that a set changed
NAMED = 8  # clips that an error names

__all__ = [
    "SETS",
    "SetFormat",
    "clip_in_set",
    "in_plane",
    "is_in_set",
    "labels_of",
    "only_clip",
    "read_set",
    "set_of",
]


def set_of(path: Path) -> SetFormat | None:
    """The kind of data set that lies at a path."""
    return next((each for each in SETS.values() if each.looks(path)), None)


def read_set(path: Path) -> Dataset:
    """The clips of a data set that lies at a path.

    Raises:
        InputError: none of a known kind, a damaged one, or one without clips.
    """
    told = (path, *(path / name for name in TOLD))
    return _read(path.resolve(), path, tuple(p.stat().st_mtime_ns for p in told if p.exists()))


@lru_cache(KEPT)
def _read(_where: Path, path: Path, _changed: tuple[int, ...]) -> Dataset:
    kind = set_of(path)
    if kind is None:
        raise InputError(f"{path}: no data set of a known kind ({', '.join(SETS)})")
    try:
        found = kind.read(path)
    except InputError as error:
        text = str(error)
        raise InputError(text if str(path) in text else f"{path}: {text}") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    if not found.files:
        raise InputError(f"{path}: no clips in this data set")
    return found


def is_in_set(path: Path) -> bool:
    """Whether a path is that of a data set and a name therein."""
    root = next((parent for parent in path.parents if parent.exists()), path)
    return not path.exists() and set_of(root) is not None


def only_clip(path: Path) -> Path:
    """The path of the clip of a data set that holds but one; any other path as it is.

    Raises:
        InputError: a data set of several clips.
    """
    if not path.exists() or set_of(path) is None:
        return path
    found = [file.path for file in read_set(path).files]
    if len(found) == 1:
        return found[0]
    named = ", ".join(str(each) for each in found[:NAMED]) + (", ..." if found[NAMED:] else "")
    raise InputError(f"{path}: {len(found)} clips; give one of them: {named}")


def clip_in_set(path: Path) -> ClipFile:
    """A clip of a data set, by the path of the set and its name therein.

    Raises:
        InputError: nothing is there.
    """
    if not is_in_set(path):
        raise InputError(f"{path}: no such file; give the path of a video")
    root = next(parent for parent in path.parents if parent.exists())
    found = {file.path: file for file in read_set(root).files}
    if path not in found:
        some = ", ".join(str(each.relative_to(root)) for each in list(found)[:NAMED])
        more = ", ..." if len(found) > NAMED else ""
        raise InputError(f"{path}: no such clip; {root} has {some}{more}")
    return found[path]
