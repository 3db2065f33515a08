"""What a verb is given: one clip, a folder of clips, or a data set of another kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.sets.folder import read_file, read_folder
from vidphys.errors import InputError


def find_dataset(path: Path, columns: Mapping[str, str] | None = None) -> Dataset:
    """The clips that ``path`` names.

    Args:
        path: a clip, or a folder of clips.
        columns: what columns of their labels are, where their names do not tell.

    Raises:
        InputError: nothing there, a folder without clips or of a rendering that is not finished,
            a manifest that is wrong, or labels beside some of the clips only.
    """
    if path.is_file():
        return replace(read_file(path), columns=columns or {})
    if not path.is_dir():
        raise InputError(f"{path}: no such file or folder; give a clip or a folder of clips")
    found = read_folder(path)
    bare = [f.path.name for f in found.files if f.labels is None]
    if 0 < len(bare) < len(found.files):
        raise InputError(
            f"{path}: {len(bare)} of {len(found.files)} clips have no labels (the first is "
            f"{bare[0]}); label all of them or none"
        )
    return replace(found, columns=columns or {})


def clip_file(path: Path) -> ClipFile:
    """A clip with what is known of it.

    Raises:
        InputError: no such file, or a manifest that is wrong.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a clip")
    return read_file(path).files[0]
