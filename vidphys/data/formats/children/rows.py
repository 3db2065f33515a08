"""The program that reads rows of a data set from an Arrow stream or a Parquet file.

``columns`` sends one message: what the columns are, and what rows hold beside pictures and films.
``cells`` sends the bytes of those, a message before each.
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from arrowed import is_list, is_plain, is_words, lengths, nested, plain
from confined import BYTES, FILE, RefusedError, allow, confine, refusing, require_room, say, send
from confined import write as send_bytes

WORDS = 300  # characters of a word that are kept
ROWS = 256  # of a Parquet file that are held at once


def main(kind: str, what: str, memory: int, seconds: int, *more: str) -> None:
    """Read the file.

    Args:
        kind: of it: ``arrow`` or ``parquet``.
        what: is read: ``columns`` or ``cells``.
        memory: bytes that may be asked for, on top of those of the libraries.
        seconds: of processor time, for what is sent in one message.
        more: see :func:`columns` and :func:`cells`.
    """
    rows = KINDS[kind]()
    confine(memory)
    allow(seconds)
    with refusing("a table of a data set", memory):
        rows.open()
        if what == "columns":
            columns(rows, *map(int, more))
        else:
            cells(rows, seconds, *more)


class Stream:
    """An Arrow stream, mapped before there are limits, so that only what it unpacks counts."""

    def __init__(self) -> None:
        self.source = pa.memory_map(FILE)

    def open(self) -> None:
        """What its columns are."""
        self.schema = pa.ipc.open_stream(self.source).schema

    def batches(self, names: list[str]) -> Iterator[pa.RecordBatch]:
        """Some rows after the other, of some columns."""
        taken = [self.schema.get_field_index(name) for name in names]
        self.source.seek(0)
        options = pa.ipc.IpcReadOptions(included_fields=taken, use_threads=False)
        for batch in pa.ipc.open_stream(self.source, options=options):
            batch.validate(full=True)
            yield batch


class Parquet:
    """A Parquet file."""

    def open(self) -> None:
        """What its columns are."""
        self.file = pq.ParquetFile(FILE)
        self.schema = self.file.schema_arrow

    def batches(self, names: list[str]) -> Iterator[pa.RecordBatch]:
        """Some rows after the other, of some columns."""
        return self.file.iter_batches(ROWS, columns=names, use_threads=False)


KINDS: dict[str, type[Stream] | type[Parquet]] = {"arrow": Stream, "parquet": Parquet}


def columns(rows: Stream | Parquet, most_bytes: int, most_columns: int) -> None:
    """Send what the columns are, and those that are no media; of these, where they say they lie.

    Args:
        rows: of the file.
        most_bytes: of numbers.
        most_columns: of a table.
    """
    schema = rows.schema
    if len(schema) > most_columns:
        raise RefusedError(f"{len(schema)} columns, more than {most_columns}")
    if len(set(schema.names)) < len(schema):
        raise RefusedError("two columns have one name; give each a name of its own")
    kinds = _kinds(schema)
    taken = [name for name, kind in kinds.items() if kind in ("numbers", "video", "pictures")]
    if isinstance(rows, Parquet):  # whose cells are unpacked before they are looked at
        taken = [name for name in taken if kinds[name] == "numbers"]
    found: dict[str, list[Any]] = {name: [] for name in taken}
    size = count = 0
    for batch in rows.batches(taken or schema.names[:1]):
        count += len(batch)
        for name in taken:
            piece = _piece(batch.column(batch.schema.get_field_index(name)), kinds[name], name)
            found[name].append(piece)
            size += sum(x.nbytes for x in piece) if isinstance(piece, list) else piece.nbytes
        require_room((size // BYTES,), most_bytes, "a table")
    arrays, shapes = {}, {}
    for name, pieces in found.items():
        arrays[name], shapes[name] = _joined(pieces)
    ragged = {name: shape for name, shape in shapes.items() if shape is not None}
    send(arrays, count=count, kinds=kinds, ragged=ragged)


def _piece(column: pa.Array, kind: str, name: str) -> np.ndarray | list[np.ndarray]:
    if kind == "pictures":
        return lengths(column)
    if kind == "video":
        column = pc.struct_field(column, "path")
    if is_list(column.type):
        return nested(column, name)
    return plain(pc.utf8_slice_codeunits(column, 0, WORDS) if is_words(column.type) else column)


def _joined(pieces: list[Any]) -> tuple[np.ndarray, list[tuple[int, ...]] | None]:
    """Pieces as one array; rows of unequal shapes flat, and the shape of each."""
    if not pieces:
        return np.zeros(0), None
    shapes = {None if isinstance(x, list) else x.shape[1:] for x in pieces}
    if len(shapes) == 1 and None not in shapes:
        return np.concatenate(pieces), None
    rows = [row for piece in pieces for row in piece]
    return np.concatenate([row.ravel() for row in rows]), [row.shape for row in rows]


def _kinds(schema: pa.Schema) -> dict[str, str]:
    """What each column is: video, pictures (a list in each row), picture, numbers, or nothing."""
    about = json.loads((schema.metadata or {}).get(b"huggingface", b"{}"))
    told = about.get("info", {}).get("features", {})
    return {field.name: _kind(field, told.get(field.name)) for field in schema}


def _kind(field: pa.Field, told: Any) -> str:
    kind = field.type
    if is_plain(kind):
        return "numbers"
    if is_list(kind):
        within = told.get("feature") if isinstance(told, dict) else None
        return "pictures" if _kind(kind.value_field, within) == "picture" else ""
    if not pa.types.is_struct(kind):
        return ""
    if {kind.field(k).name for k in range(kind.num_fields)} != {"bytes", "path"}:
        return ""
    named = told.get("_type") if isinstance(told, dict) else None
    return {"Video": "video", "Image": "picture", None: "picture"}.get(named, "")


def cells(rows: Stream | Parquet, seconds: int, column: str, *ranges: str) -> None:
    """Send the bytes of some cells, or the path that one has instead.

    Args:
        rows: of the file.
        seconds: see :func:`main`.
        column: of media.
        ranges: of rows, rising, such as ``3-7``: the first, and the one after the last.
    """
    wanted = [tuple(map(int, text.split("-"))) for text in ranges]
    here = 0
    for batch in rows.batches([column]):
        held = batch.column(batch.schema.get_field_index(column))
        for first, stop in wanted:
            for row in range(max(first, here), min(stop, here + len(batch))):
                value = held[row - here]
                for each in value.values or () if is_list(held.type) else [value]:
                    allow(seconds)
                    _send_cell(each)
        here += len(batch)
        if here >= wanted[-1][1]:
            break
    say({"end": True})


def _send_cell(cell: pa.StructScalar) -> None:
    data = cell["bytes"].as_buffer() if cell.is_valid else None
    if data is None:
        say({"path": cell["path"].as_py() if cell.is_valid else None})
        return
    say({"size": data.size})
    send_bytes(data)


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        kind, what, memory, seconds, *more = sys.argv[1:]
        main(kind, what, int(memory), int(seconds), *more)
