"""Parquet files that hold a hash of their rows, so that a changed byte is seen on reading."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

HASH = b"rows_sha256"  # in the metadata of a table
SCHEMA = b"schema_version"  # likewise
SCHEMA_VERSION = 2  # 1 did not say its number


def write_hashed(table: pa.Table, path: Path) -> None:
    """Write a table with a hash of its rows."""
    import pyarrow.parquet as pq

    marked = {**(table.schema.metadata or {}), HASH: _hash(table)}
    marked[SCHEMA] = str(SCHEMA_VERSION).encode()
    whole = table.replace_schema_metadata(marked)
    pq.write_table(whole, path, write_page_checksum=True)


def read_hashed(path: Path) -> pa.Table:
    """Read a table back, with its metadata but for the hash, which what lies there must fit.

    Raises:
        ValueError: it is damaged, or a newer vidphys wrote it; one of before there was a hash is
            only read.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:  # no data sets' reader
            table = file.read()
        marks = dict(table.schema.metadata or {})
        version = int(marks.pop(SCHEMA, b"1"))
        unmarked = HASH not in marks and version == 1
        good = version > SCHEMA_VERSION or unmarked or marks.pop(HASH, b"") == _hash(table)
    except (OSError, ValueError, pa.ArrowException) as error:
        said = " ".join(str(error).split())
        raise ValueError(f"{path}: damaged ({said}); delete it and run again") from error
    if version > SCHEMA_VERSION:
        raise ValueError(f"{path}: schema version {version}, this vidphys reads {SCHEMA_VERSION}")
    if not good:
        raise ValueError(f"{path}: damaged (its rows do not fit its hash); delete it and run again")
    return table.replace_schema_metadata(marks or None)


def _hash(table: pa.Table) -> bytes:
    text = json.dumps([table.schema.names, table.to_pylist()], default=str)
    return hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest().encode()
