"""A data set of Hugging Face on disk (``save_to_disk``): Arrow files, read without their package.

A row is a clip, by a column of videos or of lists of images; or a frame, by a column of images, and
then rows of one ``episode_index``, ``clip`` or ``video`` are a clip. Columns that are lists as long
as the clip, or numbers of frames, are its labels and times; single numbers and words are facts.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from vidphys.boundary import is_below
from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.formats.bounded import MOST_TEXT, reading
from vidphys.data.sets.base import MOST_CLIPS, SetFormat, facts_of, labels_of, times_of
from vidphys.data.sets.sources import encoded, pictures
from vidphys.errors import InputError

STATE, SPLITS = "state.json", "dataset_dict.json"
CLIPS = ("episode_index", "episode", "clip", "video_id", "video", "trial")
OPEN = 8  # Arrow files that are kept open


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
    for name in _json(path / SPLITS).get("splits", ()):
        folder = path / str(name)
        if not is_below(folder, path) or not (folder / STATE).is_file():
            raise InputError(f"split {name!a} is not there")
        yield str(name), folder


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
    for path in arrow:
        if not is_below(path, folder) or not path.is_file():
            raise InputError(f"{path.name!a} is not in {folder}")
    schema = _table(arrow[0]).schema
    kinds = _kinds(schema)
    own = next((k for k in ("video", "pictures", "picture") if k in kinds.values()), None)
    if own is None:
        raise InputError(f"no column of videos or images among {', '.join(schema.names[:40])}")
    column = next(name for name, kind in kinds.items() if kind == own)
    rows = [(path, row) for path in arrow for row in range(_table(path).num_rows)]
    if own == "picture":
        return _of_frames(rows, column, kinds, root, split), arrow
    if len(rows) > MOST_CLIPS:
        raise InputError(f"{len(rows)} clips, more than {MOST_CLIPS}")
    one = _video if own == "video" else _listed
    return [one(k, *row, column, kinds, root, split) for k, row in enumerate(rows)], arrow


def _table(path: Path) -> pa.Table:
    return _kept(path, path.stat().st_mtime_ns)


@lru_cache(OPEN)
def _kept(path: Path, _changed: int) -> pa.Table:
    """An Arrow file, mapped into memory; held to what Arrow can check of it."""
    with reading("an Arrow stream of a data set"):
        source = pa.memory_map(str(path))
        table = pa.ipc.open_stream(source).read_all()
        table.validate(full=True)
        return table


def _kinds(schema: pa.Schema) -> dict[str, str]:
    """What each column is: video, pictures (a list of images a row), picture, sound, or none."""
    told: dict[str, Any] = {}
    with reading("the features of a data set"):
        about = json.loads((schema.metadata or {}).get(b"huggingface", b"{}"))
        told = about.get("info", {}).get("features", {})
    return {field.name: _kind(field, told.get(field.name)) for field in schema}


def _kind(field: pa.Field, told: Any) -> str:
    kind = field.type
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        within = told.get("feature") if isinstance(told, dict) else None
        return "pictures" if _kind(kind.value_field, within) == "picture" else ""
    if not pa.types.is_struct(kind):
        return ""
    if {kind.field(k).name for k in range(kind.num_fields)} != {"bytes", "path"}:
        return ""
    named = told.get("_type") if isinstance(told, dict) else None
    return {"Video": "video", "Image": "picture", None: "picture"}.get(named, "other")


def _video(
    number: int, path: Path, row: int, column: str, kinds: dict[str, str], root: Path, split: str
) -> ClipFile:
    values = _values(path, row, kinds)
    lists = {name: x for name, x in values.items() if isinstance(x, list)}
    named = _cell(path, row, column, "path") or "clip.mp4"
    suffix = Path(str(named)).suffix[:8] or ".mp4"
    return ClipFile(
        root / str(number),
        labels_of("columns of the row", lists, lambda: lists) if lists else None,
        facts=facts_of(values),
        split=split,
        source=encoded(partial(_bytes, path, row, column), suffix),
    )


def _listed(
    number: int, path: Path, row: int, column: str, kinds: dict[str, str], root: Path, split: str
) -> ClipFile:
    values = _values(path, row, kinds)
    lists = {name: x for name, x in values.items() if isinstance(x, list)}
    count = len(_table(path)[column][row])
    load = [partial(_image, path, row, column, k) for k in range(count)]
    return ClipFile(
        root / str(number),
        labels_of("columns of the row", lists, lambda: lists) if lists else None,
        facts=facts_of(values),
        split=split,
        source=pictures(load, times_of(values, count)),
    )


def _of_frames(
    rows: Sequence[tuple[Path, int]], column: str, kinds: dict[str, str], root: Path, split: str
) -> list[ClipFile]:
    """Clips of rows that are frames."""
    by = next((name for name in CLIPS if name in kinds and not kinds[name]), None)
    groups: dict[str, list[tuple[Path, int]]] = {}
    for path, row in rows:
        key = "0" if by is None else str(_table(path)[by][row].as_py())
        groups.setdefault(key, []).append((path, row))
    if len(groups) > MOST_CLIPS:
        raise InputError(f"{len(groups)} clips, more than {MOST_CLIPS}")
    return [_of_rows(key, group, column, kinds, root, split) for key, group in groups.items()]


def _of_rows(
    key: str,
    rows: list[tuple[Path, int]],
    column: str,
    kinds: dict[str, str],
    root: Path,
    split: str,
) -> ClipFile:
    every = [_values(path, row, kinds) for path, row in rows]
    numbers = {n: [v[n] for v in every] for n, x in every[0].items() if not isinstance(x, str)}
    changing = {n: x for n, x in numbers.items() if any(v != x[0] for v in x)}
    load: list[Callable[[], bytes]] = [partial(_bytes, path, row, column) for path, row in rows]
    return ClipFile(
        root / key.replace("/", "_"),
        labels_of("columns of the rows", changing, lambda: changing) if changing else None,
        facts=facts_of({n: x for n, x in every[0].items() if n not in changing}),
        split=split,
        source=pictures(load, times_of({**every[0], **changing}, len(rows))),
    )


def _values(path: Path, row: int, kinds: dict[str, str]) -> dict[str, Any]:
    """All that a row holds beside pictures."""
    table = _table(path)
    return {name: table[name][row].as_py() for name, kind in kinds.items() if not kind}


def _cell(path: Path, row: int, column: str, what: str) -> Any:
    value = _table(path)[column][row]
    return value[what].as_py() if value.is_valid else None


def _bytes(path: Path, row: int, column: str) -> bytes:
    data = _cell(path, row, column, "bytes")
    return data if data is not None else _beside(path, _cell(path, row, column, "path"))


def _image(path: Path, row: int, column: str, number: int) -> bytes:
    value = _table(path)[column][row].values[number].as_py()
    return value["bytes"] if value["bytes"] is not None else _beside(path, value["path"])


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
