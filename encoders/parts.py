"""What many workers write into one store together: a part each at one stroke, then one index.

::

    STORE/shards/<name>/000012/entries.bin      tensors of the twelfth part, as in any shard
    STORE/shards/<name>/000012/manifest.jsonl   what is in it: a head with a hash of all; where
                                                entries lie; then each one's manifest, a line
    STORE/shards/<name>.sqlite                  the index of all parts; with it they can be read

A part comes into its place by renaming a folder that is whole, which fails where one is there: the
first counts, whoever else made the same. The index is built from the parts' manifests alone, in
their order, so that it is the same whoever builds it.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sqlite3
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import SpooledTemporaryFile
from types import TracebackType
from typing import Any, BinaryIO, cast

from encoders.entry import Entries, EntryFile, Origin, manifest_of
from encoders.index import LOOKED_UP, PUT, TABLE, as_row
from encoders.manifests import FeatureRequest, StaleFeatures
from encoders.placing import place
from encoders.shards import ENTRIES, aligned, synced
from encoders.store import FeatureStore

MANIFEST = "manifest.jsonl"
SCHEMA_VERSION = 3
ROWS = 2  # the schema whose rows were a line each, with the manifest as a string in it
HELD = 2**24  # bytes of an entry that is being filled, beyond which it is a temporary file
COPIED = 2**20  # bytes at once
# Nobody else has the file that is built, and a killed worker's is never read. Of larger pages there
# are fewer, which takes fewer calls and, as more rows fill each, fewer bytes.
BUILT = "PRAGMA journal_mode=OFF; PRAGMA synchronous=OFF; PRAGMA page_size=16384;"
# The first part that has a key keeps it.
ONCE = """
DELETE FROM entries WHERE rowid IN (SELECT rowid FROM (
    SELECT rowid, ROW_NUMBER() OVER (PARTITION BY key ORDER BY rowid) AS nth FROM entries
) WHERE nth > 1)
"""

Row = tuple[str | int, ...]  # see :func:`encoders.index.as_row`


class Part:
    """Entries that a worker adds to a store; a context, which leaves nothing unless committed.

    Args:
        store: what it has already is not made again.
        folder: made for this part alone, beside where it will lie.
    """

    def __init__(self, store: FeatureStore, folder: Path) -> None:
        self.store, self.folder = store, folder
        self._rows: dict[str, Row] = {}

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
        rows = _written(self._rows.values())
        said = json.loads(json.dumps(dict(about)))
        head = {"schema_version": SCHEMA_VERSION, "about": said, "sha256": _hash(said, rows)}
        with (self.folder / MANIFEST).open("wb") as file:
            file.write(json.dumps(head).encode() + b"\n" + rows)
            synced(file)
        synced(self._file)
        try:
            self.folder.rename(to)
        except OSError:
            if not to.is_dir():
                raise
            return not self.folder.exists()  # a network drive may say so of what it did
        return True


def read_part(folder: Path) -> tuple[dict[str, Any], list[Row]]:
    """What the manifest of a part says about it, and its rows.

    Raises:
        StaleFeatures: it is damaged.
    """
    path = folder / MANIFEST
    try:
        first, _, rows = path.read_bytes().partition(b"\n")
        head = json.loads(first)
        version, about = head["schema_version"], head["about"]
        if version not in (SCHEMA_VERSION, ROWS) or head["sha256"] != _hash(about, rows):
            raise ValueError("of another version, or it does not fit its hash")
        return about, _read(rows, version)
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
    # A network drive's locks may not be worth much.
    address = f"{scratch.absolute().as_uri()}?nolock=1"
    with closing(sqlite3.connect(address, uri=True)) as database:
        database.executescript(BUILT + TABLE)
        for number in range(parts):
            about, rows = read_part(folder / f"{number:06d}")
            database.executemany(PUT, ((key, number, *rest) for key, _, *rest in rows))
            yield about
        try:
            database.executescript(LOOKED_UP)
        except sqlite3.IntegrityError:  # a clip stood in two of them
            database.execute(ONCE)
            database.commit()
            database.executescript(LOOKED_UP)
    place({scratch: folder.with_name(f"{folder.name}.sqlite")})


def _written(rows: Collection[Row]) -> bytes:
    """Manifests stay the lines that they are: to quote them again takes longer than all else."""
    places, manifests = [row[:-1] for row in rows], [str(row[-1]) for row in rows]
    return "\n".join([json.dumps(places), *manifests]).encode()


def _read(rows: bytes, version: int) -> list[Row]:
    if version == ROWS:
        return [tuple(json.loads(row)) for row in rows.splitlines()]
    places, *manifests = rows.decode().split("\n")
    both = zip(json.loads(places), manifests, strict=True)
    return [(*place, manifest) for place, manifest in both]


def _hash(about: Any, rows: bytes) -> str:
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode() + b"\n" + rows).hexdigest()
