"""What a verb is given: one clip, a folder of clips, or a data set of another kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.formats import ClipFormat, format_of
from vidphys.data.sets import clip_in_set, in_plane, is_in_set, read_set, set_of
from vidphys.data.sets.folder import read_file, read_folder
from vidphys.errors import InputError
from vidphys.runs.atomic import sha256

NOT_OPENED = (".pkl", ".pickle")


def find_dataset(path: Path | str, columns: Mapping[str, str] | None = None) -> Dataset:
    """The clips that ``path`` names.

    Args:
        path: a clip, a folder of clips, a data set of another kind, or a clip of one.
        columns: what columns of their labels are, where their names do not tell.

    Raises:
        InputError: nothing there, a folder without clips or of a rendering that is not finished,
            a manifest that is wrong, or labels of some of the clips only.
    """
    found, columns = _found(Path(path)), columns or {}
    files = tuple(_with_labels(file, columns) for file in found.files)
    bare = [f.path.name for f in files if f.labels is None]
    if 0 < len(bare) < len(files):
        raise InputError(
            f"{path}: {len(bare)} of {len(files)} clips have no labels (the first is {bare[0]}); "
            "label all of them or none"
        )
    return replace(found, files=files, columns=columns)


def _found(path: Path) -> Dataset:
    if path.suffix.lower() in NOT_OPENED:
        raise InputError(
            f"{path}: a pickle can run any code, so it is not opened; load it where you trust it, "
            "and numpy.savez_compressed(NAME, video=..., points=..., occluded=...) each clip"
        )
    if path.exists() and set_of(path) is not None:
        return read_set(path)
    if path.is_file():
        return read_file(path)
    if path.is_dir():
        return read_folder(path)
    if is_in_set(path):
        return Dataset((clip_in_set(path),))
    raise InputError(f"{path}: no such file or folder; give a clip or a folder of clips")


def _with_labels(file: ClipFile, columns: Mapping[str, str]) -> ClipFile:
    """A clip without labels where no column of its data set is a place; its columns are known."""
    names = None if file.labels is None else file.labels.names
    if names is None or in_plane(names, columns):
        return file
    return replace(file, labels=None, truth=file.truth or file.labels)


def clip_file(path: Path) -> ClipFile:
    """A clip with what is known of it.

    Raises:
        InputError: no such clip, or a manifest that is wrong.
    """
    if path.is_file():
        return read_file(path).files[0]
    return clip_in_set(path)


def clips_of(path: Path) -> list[Path]:
    """The clips that a path names, whatever their labels.

    Raises:
        InputError: nothing there, or no clips.
    """
    return (
        [path] if path.is_file() and set_of(path) is None else [f.path for f in _found(path).files]
    )


def is_clip(path: Path) -> bool:
    """Whether a path is of a clip, a file's or one in a data set, by its name."""
    return is_in_set(path) or format_of(path, ClipFormat) is not None


def content_sha256(path: Path) -> str:
    """The hash of a file, or of a clip in a data set."""
    source = None if path.is_file() else clip_in_set(path).source
    return sha256(path) if source is None else source.sha256()
