"""Entries of a feature store that are files of their own.

::

    STORE/entries/<key>.entry          tensors, as in a shard; the manifest; how long that is
    STORE/entries/<key>.json           of older stores: the manifest, and
    STORE/entries/<key>.safetensors    its tensors

It is one file, so that an entry is safe after one sync. Older ones are read as they are.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from encoders.manifests import FeatureRequest, StaleFeatures, load_manifest
from encoders.placing import partial_of, place, sweep
from encoders.shards import Loose

if TYPE_CHECKING:
    import numpy as np

    from encoders.arrays import Mapped
    from encoders.entry import Entries, Origin

ENTRY, OLD, OLD_TENSORS = ".entry", ".json", ".safetensors"
TAIL = 4  # bytes that say how long the manifest before them is


class LooseEntries:
    """Reads and writes them; several processes may write at once.

    Args:
        folder: theirs; made at the first write.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._checked: set[tuple[str, int, int]] = set()
        self._swept = False

    def path(self, key: str) -> Path:
        """Of the file with an entry's manifest, whether it is there or not."""
        path, old = self.folder / f"{key}{ENTRY}", self.folder / f"{key}{OLD}"
        return old if old.exists() and not path.exists() else path

    def present(self) -> Iterator[str]:
        """Keys of what is there."""
        yield from (path.stem for path in self.folder.glob(f"*{ENTRY}"))
        for path in self.folder.glob(f"*{OLD}"):
            if not path.with_suffix(ENTRY).exists():
                yield path.stem

    def manifest(self, key: str) -> dict[str, Any] | None:
        """What is said of an entry, if it is there.

        Raises:
            StaleFeatures: see :func:`encoders.manifests.load_manifest`.
        """
        path = self.path(key)
        try:
            return self._said(path) if path.exists() else None
        except StaleFeatures:
            if path.exists():  # else it was put into a shard just now, by another process
                raise
            return None

    def whole(self) -> Iterator[Loose]:
        """Those that are as they were written, with their bytes."""
        for key in self.present():
            with suppress(StaleFeatures, OSError):
                path = self.path(key)
                manifest = self._said(path)
                with _data(path).open("rb") as file:
                    data = file.read(manifest["bytes"])
                if hashlib.sha256(data).hexdigest() == manifest["sha256"]:
                    yield Loose(key, manifest, data)

    def damaged(self) -> Iterator[str]:
        """Keys of those whose tensors are not what was written."""
        for key in self.present():
            path = self.path(key)
            try:
                self._mapped(path, self._said(path))
            except StaleFeatures:
                yield key

    def drop(self, key: str) -> None:
        """Delete an entry."""
        for ending in (ENTRY, OLD, OLD_TENSORS):  # tensors last: alone they are not read
            (self.folder / f"{key}{ending}").unlink(missing_ok=True)

    def open(self, key: str, manifest: dict[str, Any]) -> Mapped:
        """What an entry has, memory-mapped.

        Raises:
            StaleFeatures: it is not what was written.
        """
        from encoders.arrays import tensors_in

        return tensors_in(self._mapped(self.path(key), manifest))

    def begin(self, requests: Sequence[FeatureRequest], origin: Origin) -> Entries:
        """See :meth:`encoders.FeatureStore.begin`."""
        from encoders.entry import Entries, EntryFile, manifest_of

        if not self._swept:
            sweep(self.folder, ".*.partial", f"*{OLD_TENSORS}")
        self._swept = True
        places = {request: self.folder / f"{request.key}{ENTRY}" for request in requests}
        partials = {request: partial_of(path) for request, path in places.items()}
        with ExitStack() as opening:
            files = []
            for request, partial in partials.items():
                opening.callback(partial.unlink, missing_ok=True)
                file = opening.enter_context(partial.open("wb"))
                files.append(EntryFile(file, origin, request.dtype, request.grid))
            stack = opening.pop_all()

        def keep() -> None:
            for request, entry in zip(requests, files, strict=True):
                said = json.dumps(manifest_of(request, entry)).encode()
                entry.file.write(said + len(said).to_bytes(TAIL, "little"))
                entry.file.close()
            place({partial: places[request] for request, partial in partials.items()})

        return Entries(files, keep, stack.close)

    def _said(self, path: Path) -> dict[str, Any]:
        return load_manifest(path, _tail if path.suffix == ENTRY else Path.read_bytes)

    def _mapped(self, path: Path, manifest: dict[str, Any]) -> np.ndarray:
        """The bytes of an entry's tensors, compared with their hash once.

        Raises:
            StaleFeatures: they are not what was written.
        """
        from encoders.arrays import mapped

        data, again = _data(path), f"delete {path.name} to extract again"
        try:
            about = data.stat()
            found = mapped(data, 0, manifest["bytes"])
        except (OSError, ValueError) as error:
            raise StaleFeatures(
                f"feature store: {data} is missing or cut short; {again}"
            ) from error
        seen = data.name, about.st_mtime_ns, about.st_size
        same = seen in self._checked or hashlib.sha256(found.data).hexdigest() == manifest["sha256"]
        if not same:
            said = "its sha256 differs from its manifest's"
            raise StaleFeatures(f"feature store: {data} is damaged ({said}); {again}")
        self._checked.add(seen)
        return found


def _data(path: Path) -> Path:
    """The file of an entry's tensors, from that of its manifest."""
    return path.with_suffix(OLD_TENSORS) if path.suffix == OLD else path


def _tail(path: Path) -> bytes:
    """The manifest at the end of a file."""
    with path.open("rb") as file:
        file.seek(-TAIL, os.SEEK_END)
        size = int.from_bytes(file.read(TAIL), "little")
        file.seek(-TAIL - size, os.SEEK_END)
        return file.read(size)
