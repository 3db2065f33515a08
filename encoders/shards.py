"""Entries of a feature store that lie together in shards, under an index that is read row by row.

::

    STORE/shards/index.sqlite     a row an entry: its manifest, and where its tensors lie
    STORE/shards/000000.bin       tensors of many entries, one after the other

Tensors are what safetensors would write, byte for byte, each at a multiple of :data:`ALIGNED`. An
entry is there once its row is: rows are committed after the shard was synced, so that what a killed
process appended is never read. One process appends at a time; any number read.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch
from torch import Tensor

SHARD_BYTES = 2**28  # from which on the next shard is begun
ALIGNED = 64
AT_ONCE = 512  # entries that are committed together
WAIT = 60.0  # seconds for another process' commit
DTYPES = {
    "F16": torch.float16,
    "BF16": torch.bfloat16,
    "F32": torch.float32,
    "F64": torch.float64,
}
SCHEMA = """
CREATE TABLE IF NOT EXISTS entries (
    key TEXT PRIMARY KEY, shard INTEGER, place INTEGER, bytes INTEGER,
    encoder TEXT, layer TEXT, manifest TEXT
) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS encoders ON entries (encoder, layer);
"""


class DamagedShard(ValueError):
    """The bytes of an entry are not those that were written."""


@dataclass(frozen=True)
class Loose:
    """An entry that is to be put into a shard: its key, its manifest, and its tensors' bytes."""

    key: str
    manifest: dict[str, Any]
    data: bytes


@dataclass(frozen=True)
class Row:
    """Where an entry lies, and its manifest."""

    key: str
    shard: int
    place: int
    bytes: int
    manifest: dict[str, Any]


class Shards:
    """The shards of one store.

    Args:
        folder: theirs; made when the first entry is put there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._connection: tuple[int, sqlite3.Connection] | None = None
        self._checked: set[tuple[int, int]] = set()

    def row(self, key: str) -> Row | None:
        """Where an entry lies, if it does."""
        found = self._rows("WHERE key = ?", key)
        return next(found, None)

    def has(self, key: str) -> bool:
        """Whether there is such an entry."""
        database = self._database()
        if database is None:
            return False
        asked = database.execute("SELECT 1 FROM entries WHERE key = ?", (key,))
        return asked.fetchone() is not None

    def rows(self) -> Iterator[Row]:
        """All of them, in the order of their keys."""
        return self._rows("ORDER BY key")

    def counts(self) -> list[tuple[str, str, int, int]]:
        """Encoder, layer, entries and bytes."""
        database = self._database()
        if database is None:
            return []
        grouped = "SELECT encoder, layer, COUNT(*), SUM(bytes) FROM entries GROUP BY encoder, layer"
        return database.execute(grouped).fetchall()

    def add(self, entries: Iterable[Loose], kept: Callable[[str], None]) -> int:
        """Append entries; an entry of the same key is replaced.

        Args:
            entries: one after the other.
            kept: called with a key once it is safe on disk.

        Returns:
            How many there were.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        count = 0
        with self._alone():
            database = sqlite3.connect(self._index, timeout=WAIT)
            database.executescript(SCHEMA)
            number, file = self._last()
            try:
                coming = iter(entries)
                while some := [*islice(coming, AT_ONCE)]:
                    rows = []
                    for entry in some:
                        if file.tell() >= SHARD_BYTES:
                            _sync(file)
                            file.close()
                            number, file = number + 1, self._shard(number + 1).open("ab")
                        file.write(b"\0" * (-file.tell() % ALIGNED))
                        rows.append(_as_row(entry, number, file.tell()))
                        file.write(entry.data)
                    _sync(file)
                    with database:
                        database.executemany(
                            "INSERT OR REPLACE INTO entries VALUES (?, ?, ?, ?, ?, ?, ?)", rows
                        )
                    for entry in some:
                        kept(entry.key)
                    count += len(some)
            finally:
                file.close()
                database.close()
        return count

    def delete(self, encoder: str, layer: str | None = None) -> int:
        """Take out the entries of an encoder; shards of which nothing is left are deleted.

        Args:
            encoder: its name.
            layer: all where not given.
        """
        if not self._index.is_file():
            return 0
        with self._alone():
            database = sqlite3.connect(self._index, timeout=WAIT)
            with database:
                gone = database.execute(
                    "DELETE FROM entries WHERE encoder = ? AND layer = coalesce(?, layer)",
                    (encoder, layer),
                ).rowcount
            used = {number for (number,) in database.execute("SELECT DISTINCT shard FROM entries")}
            database.close()
            for file in self.folder.glob("*.bin"):
                if int(file.stem) not in used:
                    file.unlink()
        return gone

    def tensors(self, row: Row) -> tuple[Tensor, Tensor]:
        """Values ``(t, c, h, w)`` and times of an entry, memory-mapped.

        Raises:
            DamagedShard: its bytes are not those that were written.
        """
        file = self._shard(row.shard)
        try:
            mapped = np.memmap(file, np.uint8, "c", row.place, (row.bytes,))
        except (OSError, ValueError) as error:
            raise DamagedShard(f"{file} is missing or cut short") from error
        if (row.shard, row.place) not in self._checked:
            if hashlib.sha256(mapped.data).hexdigest() != row.manifest["sha256"]:
                raise DamagedShard(f"{file} is damaged at byte {row.place}")
            self._checked.add((row.shard, row.place))
        begin = 8 + int.from_bytes(mapped[:8].tobytes(), "little")
        about = json.loads(mapped[8:begin].tobytes())
        whole = torch.from_numpy(mapped)
        values, times = (_tensor(whole[begin:], about[name]) for name in ("values", "times"))
        return values, times

    @property
    def _index(self) -> Path:
        return self.folder / "index.sqlite"

    def _shard(self, number: int) -> Path:
        return self.folder / f"{number:06d}.bin"

    def _last(self) -> tuple[int, BinaryIO]:
        """The shard that is appended to."""
        number = max((int(file.stem) for file in self.folder.glob("*.bin")), default=0)
        return number, self._shard(number).open("ab")

    def _database(self) -> sqlite3.Connection | None:
        """For reading; a forked process has one of its own."""
        if self._connection is None or self._connection[0] != os.getpid():
            if not self._index.is_file():
                return None
            # where a writer was killed, the next reader has to take back what it left half done
            mode = "rw" if os.access(self._index, os.W_OK) else "ro"
            address = f"{self._index.absolute().as_uri()}?mode={mode}"
            made = sqlite3.connect(address, WAIT, uri=True, check_same_thread=False)
            self._connection = os.getpid(), made
        return self._connection[1]

    def _rows(self, which: str, *values: str) -> Iterator[Row]:
        database = self._database()
        if database is None:
            return
        wanted = f"SELECT key, shard, place, bytes, manifest FROM entries {which}"  # noqa: S608
        for key, shard, place, size, manifest in database.execute(wanted, values):
            yield Row(key, shard, place, size, json.loads(manifest))

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """While no other process changes what is here."""
        with (self.folder / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield


def _as_row(entry: Loose, number: int, place: int) -> tuple[str | int, ...]:
    encoder = entry.manifest["request"]["encoder"]
    about = number, place, len(entry.data), encoder["name"], encoder["layer"]
    return entry.key, *about, json.dumps(entry.manifest)


def _sync(file: BinaryIO) -> None:
    file.flush()
    os.fsync(file.fileno())


def _tensor(whole: Tensor, about: dict[str, Any]) -> Tensor:
    first, last = about["data_offsets"]
    return whole[first:last].view(DTYPES[about["dtype"]]).view(about["shape"])
