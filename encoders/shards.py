"""Entries of a feature store that lie together in shards, under indexes that are read row by row.

::

    STORE/shards/index.sqlite           a row an entry: its manifest, and where its tensors lie
    STORE/shards/000000.bin             tensors of many entries, one after the other
    STORE/shards/<name>.sqlite          the same of what many workers wrote together; it is
    STORE/shards/<name>/000000/         never changed in its place; see :mod:`encoders.parts`

Tensors are what safetensors would write, byte for byte, each at a multiple of :data:`ALIGNED`. An
entry is there once its row is: rows are committed after the shard was synced, so that what a killed
process appended is never read. One process appends at a time; any number read.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from encoders.index import LOOKED_UP, PUT, TABLE, WAIT, Index, Row, as_row, reading
from encoders.placing import placed

if TYPE_CHECKING:
    from encoders.arrays import Mapped

OWN = "index"  # the index of what is appended here
ENTRIES = "entries.bin"  # tensors of what a worker wrote at one stroke
SPENT = "spent"  # something was taken out of it
SHARD_BYTES = 2**28  # from which on the next shard is begun
ALIGNED = 64
ASK_AGAIN = 0.05  # seconds, while another process is at work
AT_ONCE = 512  # entries that are committed together


class DamagedShard(ValueError):
    """The bytes of an entry are not those that were written."""


@dataclass(frozen=True)
class Loose:
    """An entry that is to be put into a shard: its key, its manifest, and its tensors' bytes."""

    key: str
    manifest: dict[str, Any]
    data: bytes


class Shards:
    """The shards of one store.

    Args:
        folder: theirs; made when the first entry is put there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[tuple[str, int], Index] = {}
        self._changed = -1
        self._checked: set[tuple[Path, int]] = set()

    def row(self, key: str) -> Row | None:
        """Where an entry lies, if it does."""
        return next((row for index in self._indexes() if (row := index.row(key))), None)

    def has(self, key: str) -> bool:
        """Whether there is such an entry, in a shard that was not lost or cut short."""
        return any(index.holds(key) for index in self._indexes())

    def rows(self) -> Iterator[Row]:
        """All of them, each once."""
        before: list[Index] = []
        for index in self._indexes():
            for row in index.rows():
                if not any(other.has(row.key) for other in before):
                    yield row
            before.append(index)

    def counts(self) -> Iterator[tuple[str, str, int, int]]:
        """Encoder, layer, entries and bytes, of each index."""
        for index in self._indexes():
            yield from index.counts()

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
        with self.alone(), closing(self._open(self._index(OWN))) as database:
            database.executescript(TABLE + LOOKED_UP)
            number, file = self._last()
            try:
                coming = iter(entries)
                while some := [*islice(coming, AT_ONCE)]:
                    rows = []
                    for entry in some:
                        if file.tell() >= SHARD_BYTES:
                            synced(file)
                            file.close()
                            number, file = number + 1, self._shard(number + 1).open("ab")
                        place = aligned(file)
                        rows.append(
                            as_row(entry.key, number, place, len(entry.data), entry.manifest)
                        )
                        file.write(entry.data)
                    synced(file)
                    with database:
                        database.executemany(PUT, rows)
                    for entry in some:
                        kept(entry.key)
                    count += len(some)
            finally:
                file.close()
        return count

    def delete(self, encoder: str, layer: str | None = None) -> int:
        """Take out the entries of an encoder; shards of which nothing is left are deleted.

        Args:
            encoder: its name.
            layer: all where not given.
        """
        return self._delete("encoder = ? AND layer = coalesce(?, layer)", encoder, layer)

    def drop(self, key: str) -> bool:
        """Take out an entry; whether it was there."""
        return self._delete("key = ?", key) > 0

    def tensors(self, row: Row) -> Mapped:
        """What an entry has, memory-mapped.

        Raises:
            DamagedShard: its bytes are not those that were written.
        """
        from encoders.arrays import mapped, tensors_in

        try:
            data = mapped(row.file, row.place, row.bytes)
        except (OSError, ValueError) as error:
            raise DamagedShard(f"{row.file} is missing or cut short") from error
        if (row.file, row.place) not in self._checked:
            if hashlib.sha256(data.data).hexdigest() != row.manifest["sha256"]:
                raise DamagedShard(f"{row.file} is damaged at byte {row.place}")
            self._checked.add((row.file, row.place))
        return tensors_in(data)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """While no other process changes what is here; one that does is waited for.

        Raises:
            ValueError: it is at it for longer than :data:`WAIT`, or a file here is a link, which
                would be written through.
        """
        for path in (self.folder, *self.folder.iterdir()):
            if path.is_symlink():
                raise ValueError(f"feature store: {path} is a link; put what it leads to there")
        lock = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            self._wait_for(lock)
            yield
        finally:
            os.close(lock)

    def _wait_for(self, lock: int) -> None:
        until = time.monotonic() + WAIT
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError as error:
                if time.monotonic() > until:
                    raise ValueError(
                        f"feature store {self.folder.parent}: another process packs, deletes or "
                        "copies there; wait for it, or end it if it hangs"
                    ) from error
            time.sleep(ASK_AGAIN)

    def _indexes(self) -> list[Index]:
        """The own one first; looked for again whenever a name in the folder changed."""
        try:
            changed = self.folder.stat().st_mtime_ns
        except FileNotFoundError:
            return []
        if changed != self._changed:
            names = sorted(self.folder.glob("[!.]*.sqlite"), key=lambda p: (p.stem != OWN, p.stem))
            now = {(path.stem, path.stat().st_ino): path for path in names}
            for gone in self._known.keys() - now.keys():
                self._known[gone].close()
            self._known = {at: self._known.get(at) or self._of(path) for at, path in now.items()}
            self._changed = changed
        return [*self._known.values()]

    def _of(self, path: Path) -> Index:
        if path.stem == OWN:
            return Index(path, self._shard, frozen=False)
        folder = self.folder / path.stem
        return Index(path, lambda number: folder / f"{number:06d}" / ENTRIES, frozen=True)

    def _delete(self, which: str, *values: str | None) -> int:
        gone = 0
        if not self._indexes():
            return 0
        with self.alone():
            for index in self._indexes():
                if not index.frozen:
                    gone += self._deleted(index.path, which, values)
                elif self._counted(index.path, which, values):
                    (self.folder / index.path.stem / SPENT).touch()
                    with placed(index.path) as partial:
                        shutil.copyfile(index.path, partial)
                        gone += self._deleted(partial, which, values)
                self._clear(index.path)
        return gone

    def _deleted(self, path: Path, which: str, values: tuple[str | None, ...]) -> int:
        with reading(path), closing(self._open(path)) as database, database:
            done = database.execute(f"DELETE FROM entries WHERE {which}", values)  # noqa: S608
            return done.rowcount

    def _clear(self, path: Path) -> None:
        """Delete the shards of which an index has nothing."""
        with reading(path), closing(self._open(path)) as database:
            used = {number for (number,) in database.execute("SELECT DISTINCT shard FROM entries")}
        if path.stem == OWN:
            for shard in self.folder.glob("*.bin"):
                if int(shard.stem) not in used:
                    shard.unlink()
            return
        for part in (self.folder / path.stem).glob("[0-9]" * 6):
            if int(part.name) not in used:
                shutil.rmtree(part)

    def _counted(self, path: Path, which: str, values: tuple[str | None, ...]) -> int:
        with reading(path), closing(self._open(path)) as database:
            counted = f"SELECT COUNT(*) FROM entries WHERE {which}"  # noqa: S608
            return int(database.execute(counted, values).fetchone()[0])

    def _open(self, path: Path) -> sqlite3.Connection:
        return sqlite3.connect(path, timeout=WAIT)

    def _index(self, name: str) -> Path:
        return self.folder / f"{name}.sqlite"

    def _shard(self, number: int) -> Path:
        return self.folder / f"{number:06d}.bin"

    def _last(self) -> tuple[int, BinaryIO]:
        """The shard that is appended to."""
        number = max((int(file.stem) for file in self.folder.glob("*.bin")), default=0)
        return number, self._shard(number).open("ab")


def aligned(file: BinaryIO) -> int:
    """Fill a file up to where an entry may begin; returns that place."""
    file.write(b"\0" * (-file.tell() % ALIGNED))
    return file.tell()


def synced(file: BinaryIO) -> None:
    """Wait until all that was written is on the disk."""
    file.flush()
    os.fsync(file.fileno())
