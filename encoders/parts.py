"""What many workers write into one store together: a part each at one stroke, then one index.

::

    STORE/shards/<name>/000012/entries.bin      tensors of the twelfth part, as in any shard
    STORE/shards/<name>/000012/manifest.jsonl   what is in it: a head with a hash of all, rows
    STORE/shards/<name>.sqlite                  the index of all parts; with it they can be read

A part comes into its place by renaming a folder that is whole, which fails where one is there: the
first counts, whoever else made the same. The index is built from the parts' manifests alone, in
their order, so that it is the same whoever builds it.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import SpooledTemporaryFile
from types import TracebackType
from typing import Any, BinaryIO, cast

from encoders.entry import Entries, EntryFile, Origin, manifest_of
from encoders.index import LOOKED_UP, PUT, TABLE, as_row
from encoders.manifests import FeatureRequest, StaleFeatures
from encoders.placing import place, placed
from encoders.shards import ENTRIES, aligned
from encoders.store import FeatureStore

MANIFEST = "manifest.jsonl"
SCHEMA_VERSION = 2  # from which on the hash is of all that is said, too
HELD = 2**24  # bytes of an entry that is being filled, beyond which it is a temporary file
COPIED = 2**20  # bytes at once
# The first part that has a key keeps it.
ONCE = """
DELETE FROM entries WHERE rowid IN (SELECT rowid FROM (
    SELECT rowid, ROW_NUMBER() OVER (PARTITION BY key ORDER BY rowid) AS nth FROM entries
) WHERE nth > 1)
"""


class Part:
    """Entries that a worker adds to a store; a context, which leaves nothing unless committed.

    Args:
        store: what it has already is not made again.
        folder: made for this part alone, beside where it will lie.
    """

    def __init__(self, store: FeatureStore, folder: Path) -> None:
        self.store, self.folder = store, folder
        self._rows: dict[str, tuple[str | int, ...]] = {}

    def __enter__(self) -> Part:
        self.folder.mkdir(parents=True)
        self._file: BinaryIO = (self.folder / ENTRIES).open("wb")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def __len__(self) -> int:
        return len(self._rows)

    def has(self, request: FeatureRequest) -> bool:
        """Whether the store or this part has an entry of ``request``."""
        return request.key in self._rows or self.store.has(request)

    def begin(self, requests: Sequence[FeatureRequest], origin: Origin) -> Entries:
        """See :meth:`encoders.FeatureStore.begin`."""
        with ExitStack() as opening:
            files = []
            for request in requests:
                spool = opening.enter_context(SpooledTemporaryFile(HELD))
                file = cast(BinaryIO, spool)
                files.append(EntryFile(file, origin, request.dtype, request.grid))
            stack = opening.pop_all()

        def keep() -> None:
            for request, entry in zip(requests, files, strict=True):
                manifest = manifest_of(request, entry)
                entry.file.seek(0)
                begun = aligned(self._file)
                shutil.copyfileobj(entry.file, self._file, COPIED)
                row = as_row(request.key, 0, begun, manifest["bytes"], manifest)
                self._rows[request.key] = row

        return Entries(files, keep, stack.close)

    def commit(self, to: Path, about: Mapping[str, Any]) -> bool:
        """Put the part in its place, whole; whether it was the first there.

        Args:
            to: its folder there.
            about: what else its manifest is to say.
        """
        rows = "".join(json.dumps(row) + "\n" for row in self._rows.values()).encode()
        said = json.loads(json.dumps(dict(about)))
        head = {"schema_version": SCHEMA_VERSION, "about": said, "sha256": _hash(said, rows)}
        with placed(self.folder / MANIFEST) as partial:
            partial.write_bytes(json.dumps(head).encode() + b"\n" + rows)
        self._file.flush()
        os.fsync(self._file.fileno())
        try:
            self.folder.rename(to)
        except OSError:
            if not to.is_dir():
                raise
            return not self.folder.exists()  # a network drive may say so of what it did
        return True


def read_part(folder: Path) -> tuple[dict[str, Any], list[Any]]:
    """What the manifest of a part says about it, and its rows.

    Raises:
        StaleFeatures: it is damaged.
    """
    path = folder / MANIFEST
    try:
        first, _, rows = path.read_bytes().partition(b"\n")
        head = json.loads(first)
        if head["schema_version"] != SCHEMA_VERSION or head["sha256"] != _hash(head["about"], rows):
            raise ValueError("of another version, or it does not fit its hash")
        return head["about"], [json.loads(row) for row in rows.splitlines()]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise StaleFeatures(
            f"feature store: {path} is damaged ({error}); delete {folder} to extract it again"
        ) from error


def join(folder: Path, parts: int, scratch: Path) -> Iterator[Mapping[str, Any]]:
    """Build the index of parts that are all there, and put it in its place at the end.

    Args:
        folder: of the parts; the index comes beside it.
        parts: how many there are.
        scratch: a file that nobody else writes, in which it is built.

    Yields:
        What each manifest says about its part.

    Raises:
        StaleFeatures: a damaged manifest.
    """
    # Nobody else has this file, and a network drive's locks may not be worth much.
    address = f"{scratch.absolute().as_uri()}?nolock=1"
    with closing(sqlite3.connect(address, uri=True)) as database:
        database.executescript(f"PRAGMA journal_mode=OFF; PRAGMA synchronous=OFF; {TABLE}")
        for number in range(parts):
            about, rows = read_part(folder / f"{number:06d}")
            database.executemany(PUT, ((key, number, *rest) for key, _, *rest in rows))
            database.commit()
            yield about
        try:
            database.executescript(LOOKED_UP)
        except sqlite3.IntegrityError:  # a clip stood in two of them
            database.execute(ONCE)
            database.commit()
            database.executescript(LOOKED_UP)
    place({scratch: folder.with_name(f"{folder.name}.sqlite")})


def _hash(about: Any, rows: bytes) -> str:
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode() + b"\n" + rows).hexdigest()
