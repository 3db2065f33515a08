"""A data set of Hugging Face on disk (``save_to_disk``): Arrow files, read without their package.

A row is a clip, by a column of videos or of lists of images; or a frame, by a column of images, and
then rows of one ``episode_index``, ``clip`` or ``video`` are a clip. Columns that are lists as long
as the clip, or numbers of frames, are its labels and times; single numbers and words are facts.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from vidphys.boundary import is_below
from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.formats.bounded import MOST_TEXT, reading
from vidphys.data.sets.apart import Rows, cells_of, rows_of
from vidphys.data.sets.base import MOST_CLIPS, SetFormat, facts_of, labels_of, times_of
from vidphys.data.sets.sources import encoded, pictures
from vidphys.errors import InputError

STATE, SPLITS = "state.json", "dataset_dict.json"
CLIPS = ("episode_index", "episode", "clip", "video_id", "video", "trial")


def looks(path: Path) -> bool:
    """Whether a folder is of this kind."""
    return (path / STATE).is_file() or (path / SPLITS).is_file()


def read(path: Path) -> Dataset:
    """The clips of all splits."""
    files: list[ClipFile] = []
    stored: list[Path] = []
    for name, folder in _splits(path):
        found, arrow = _split(folder, path / name if name else path, name)
        files += found
        stored += arrow
    return Dataset(tuple(files), stored=tuple(stored))


def _splits(path: Path) -> Iterator[tuple[str, Path]]:
    if not (path / SPLITS).is_file():
        yield "", path
        return
    with reading("a list of splits"):
        names = [str(name) for name in _json(path / SPLITS)["splits"]]
    for name in names:
        folder = path / name
        if not is_below(folder, path) or not (folder / STATE).is_file():
            raise InputError(f"split {name!a} is not there")
        yield name, folder


def _json(path: Path) -> dict[str, Any]:
    if path.stat().st_size > MOST_TEXT:
        raise InputError(f"{path}: more than {MOST_TEXT >> 20} MiB")
    with reading(f"JSON in {path.name}"):
        held = json.loads(path.read_bytes())
    if not isinstance(held, dict):
        raise InputError(f"{path}: not an object")
    return held


def _split(folder: Path, root: Path, split: str) -> tuple[list[ClipFile], list[Path]]:
    with reading("a list of Arrow files"):
        names = [str(each["filename"]) for each in _json(folder / STATE)["_data_files"]]
    arrow = [folder / name for name in names]
    if not arrow:
        raise InputError(f"{STATE} names no file of rows")
    for path in arrow:
        if not is_below(path, folder) or not path.is_file():
            raise InputError(f"{path.name!a} is not in {folder}")
    kinds = _table(arrow[0]).kinds
    own = next((k for k in ("video", "pictures", "picture") if k in kinds.values()), None)
    if own is None:
        raise InputError(f"no column of videos or images among {', '.join(list(kinds)[:40])}")
    column = next(name for name, kind in kinds.items() if kind == own)
    rows = [(path, row) for path in arrow for row in range(_table(path).count)]
    if own == "picture":
        return _of_frames(rows, column, root, split), arrow
    if len(rows) > MOST_CLIPS:
        raise InputError(f"{len(rows)} clips, more than {MOST_CLIPS}")
    return [_clip(root / str(k), *row, column, split) for k, row in enumerate(rows)], arrow


def _table(path: Path) -> Rows:
    return rows_of(path, "arrow")


def _clip(name: Path, path: Path, row: int, column: str, split: str) -> ClipFile:
    """The clip of a row: a film, or a list of images."""
    table = _table(path)
    values = table.values(row)
    lists = {name: x for name, x in values.items() if np.ndim(x)}
    told = table.columns[column][row]
    load = partial(_media, column, [(path, row)])
    if table.kinds[column] == "video":
        suffix = Path(str(told)).suffix[:8] or ".mp4"
        source = encoded(lambda: next(load()), suffix)
    else:
        source = pictures(load, times_of(values, int(told)))
    return ClipFile(
        name,
        labels_of("columns of the row", lists, lambda: lists) if lists else None,
        facts=facts_of(values),
        split=split,
        source=source,
    )


def _of_frames(
    rows: Sequence[tuple[Path, int]], column: str, root: Path, split: str
) -> list[ClipFile]:
    """Clips of rows that are frames."""
    first = _table(rows[0][0]) if rows else None
    by = next((n for n in CLIPS if first is not None and first.kinds.get(n) == "numbers"), None)
    groups: dict[str, list[tuple[Path, int]]] = {}
    for path, row in rows:
        key = "0" if by is None else str(_table(path).columns[by][row])
        groups.setdefault(key, []).append((path, row))
    if len(groups) > MOST_CLIPS:
        raise InputError(f"{len(groups)} clips, more than {MOST_CLIPS}")
    return [_of_rows(key, group, column, root, split) for key, group in groups.items()]


def _of_rows(
    key: str, rows: list[tuple[Path, int]], column: str, root: Path, split: str
) -> ClipFile:
    every = [_table(path).values(row) for path, row in rows]
    numbers = {
        n: [v.get(n, np.nan) for v in every] for n, x in every[0].items() if not isinstance(x, str)
    }
    changing = {n: x for n, x in numbers.items() if any(not np.array_equal(v, x[0]) for v in x)}
    return ClipFile(
        root / key.replace("/", "_"),
        labels_of("columns of the rows", changing, lambda: changing) if changing else None,
        facts=facts_of({n: x for n, x in every[0].items() if n not in changing}),
        split=split,
        source=pictures(
            partial(_media, column, rows), times_of({**every[0], **changing}, len(rows))
        ),
    )


def _media(column: str, rows: Sequence[tuple[Path, int]]) -> Iterator[bytes]:
    """The bytes of pictures or films."""
    for path, some in groupby(rows, lambda each: each[0]):
        for cell in cells_of(path, "arrow", column, [row for _, row in some]):
            yield cell if isinstance(cell, bytes) else _beside(path, cell)


def _beside(arrow: Path, name: Any) -> bytes:
    """A file that a row names instead of holding its bytes."""
    file = arrow.parent / str(name)
    if name is None or not is_below(file, arrow.parent) or not file.is_file():
        raise InputError(
            f"{arrow.name} names the file {str(name)!a}, which is not in its folder, and holds no "
            "bytes of it; save the data set with its media in it"
        )
    return file.read_bytes()


HUGGING_FACE = SetFormat(looks, read)
