"""An index of entries in shards: a row an entry, read one by one, so that millions cost nothing."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from encoders.manifests import StaleFeatures

WAIT = 60.0  # seconds for another process' commit
# Rows lie in the order in which they came: keys are hashes, and rows in their order would be
# written all over the file.
TABLE = """
CREATE TABLE IF NOT EXISTS entries (
    key TEXT, shard INTEGER, place INTEGER, bytes INTEGER, encoder TEXT, layer TEXT, manifest TEXT
);
"""
LOOKED_UP = """
CREATE UNIQUE INDEX IF NOT EXISTS keys ON entries (key);
CREATE INDEX IF NOT EXISTS makers ON entries (encoder, layer, bytes);
"""
# What sqlite says of others at work, or of a file that is gone by now: no damage.
PASSING = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_CANTOPEN)
PUT = "INSERT OR REPLACE INTO entries VALUES (?, ?, ?, ?, ?, ?, ?)"


@dataclass(frozen=True)
class Row:
    """Where an entry lies, and its manifest."""

    key: str
    index: Path
    file: Path
    place: int
    bytes: int
    manifest: dict[str, Any]


class Index:
    """Reads one; a forked process has a connection of its own.

    Args:
        path: of the database, which is there.
        shard: the file of a shard, by its number.
        frozen: it is never changed in its place, so that nobody needs a lock.
    """

    def __init__(self, path: Path, shard: Callable[[int], Path], frozen: bool) -> None:
        self.path, self.shard, self.frozen = path, shard, frozen
        self._connection: tuple[int, sqlite3.Connection] | None = None
        self._sizes: dict[int, int] = {}  # of the shards, in bytes, when last looked at

    def row(self, key: str) -> Row | None:
        """Where an entry lies, if it does."""
        return next(self._rows("WHERE key = ?", key), None)

    def has(self, key: str) -> bool:
        """Whether there is such an entry."""
        with reading(self.path):
            asked = self._database().execute("SELECT 1 FROM entries WHERE key = ?", (key,))
            return asked.fetchone() is not None

    def holds(self, key: str) -> bool:
        """Whether there is such an entry, and its shard reaches as far; its bytes are not read."""
        with reading(self.path):
            asked = "SELECT shard, place + bytes FROM entries WHERE key = ?"
            found = self._database().execute(asked, (key,)).fetchone()
        return found is not None and self._reaches(*found)

    def _reaches(self, shard: int, end: int) -> bool:
        if self._sizes.get(shard, -1) < end:  # it may have grown since
            try:
                self._sizes[shard] = self.shard(shard).stat().st_size
            except FileNotFoundError:
                return False
        return self._sizes[shard] >= end

    def rows(self) -> Iterator[Row]:
        """All of them."""
        return self._rows("")

    def counts(self) -> list[tuple[str, str, int, int]]:
        """Encoder, layer, entries and bytes."""
        grouped = "SELECT encoder, layer, COUNT(*), SUM(bytes) FROM entries GROUP BY encoder, layer"
        with reading(self.path):
            return self._database().execute(grouped).fetchall()

    def close(self) -> None:
        """Of this process."""
        if self._connection is not None and self._connection[0] == os.getpid():
            self._connection[1].close()
        self._connection = None

    def _database(self) -> sqlite3.Connection:
        if self._connection is None or self._connection[0] != os.getpid():
            # where a writer was killed, the next reader has to take back what it left half done
            mode = "mode=rw" if os.access(self.path, os.W_OK) else "mode=ro"
            address = f"{self.path.absolute().as_uri()}?{'immutable=1' if self.frozen else mode}"
            made = sqlite3.connect(address, WAIT, uri=True, check_same_thread=False)
            self._connection = os.getpid(), made
        return self._connection[1]

    def _rows(self, which: str, *values: str) -> Iterator[Row]:
        wanted = f"SELECT key, shard, place, bytes, manifest FROM entries {which}"  # noqa: S608
        with reading(self.path):
            for key, shard, place, size, manifest in self._database().execute(wanted, values):
                where = self.path, self.shard(shard), int(place), int(size)
                yield Row(key, *where, json.loads(manifest))


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Whatever sqlite says of a damaged index, as one line.

    Raises:
        StaleFeatures: it is damaged.
    """
    try:
        yield
    except (sqlite3.DatabaseError, ValueError, TypeError, OverflowError, RecursionError) as error:
        if isinstance(error, StaleFeatures) or _code(error) in PASSING:
            raise
        raise StaleFeatures(
            f"feature store: {path} is damaged ({' '.join(str(error).split())}); restore it, or "
            "delete it to extract again"
        ) from error


def _code(error: Exception) -> int:
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def as_row(
    key: str, shard: int, place: int, size: int, manifest: dict[str, Any]
) -> tuple[str | int, ...]:
    """What :data:`PUT` takes."""
    encoder = manifest["request"]["encoder"]
    return key, shard, place, size, encoder["name"], encoder["layer"], json.dumps(manifest)
