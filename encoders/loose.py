"""Entries of a feature store that are files of their own: a manifest and its tensors each.

::

    STORE/entries/<key>.json           the manifest; renamed into place last
    STORE/entries/<key>.safetensors    values (t, c, h, w) and times, memory-mapped when read
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from encoders.manifests import FeatureRequest, StaleFeatures, load_manifest
from encoders.placing import partial_of, place, sweep
from encoders.release import file_sha256
from encoders.shards import Loose

if TYPE_CHECKING:
    from encoders.entry import Entries, Origin
    from encoders.features import FeatureMap

TENSORS = ".safetensors"


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
        """Of an entry's manifest, whether it is there or not."""
        return self.folder / f"{key}.json"

    def present(self) -> Iterator[str]:
        """Keys of what is there."""
        return (path.stem for path in self.folder.glob("*.json"))

    def manifest(self, key: str) -> dict[str, Any] | None:
        """What is said of an entry, if it is there.

        Raises:
            StaleFeatures: see :func:`encoders.manifests.load_manifest`.
        """
        path = self.path(key)
        try:
            return load_manifest(path) if path.exists() else None
        except StaleFeatures:
            if path.exists():  # else it was put into a shard just now, by another process
                raise
            return None

    def whole(self) -> Iterator[Loose]:
        """Those that are as they were written, with their bytes."""
        for key in self.present():
            with suppress(StaleFeatures, OSError):
                manifest, data = load_manifest(self.path(key)), self._data(key).read_bytes()
                if hashlib.sha256(data).hexdigest() == manifest["sha256"]:
                    yield Loose(key, manifest, data)

    def damaged(self) -> Iterator[str]:
        """Keys of those whose tensors are not what was written."""
        for key in self.present():
            data = self._data(key)
            if not data.exists() or file_sha256(data) != load_manifest(self.path(key))["sha256"]:
                yield key

    def drop(self, key: str) -> None:
        """Delete an entry."""
        self.path(key).unlink(missing_ok=True)  # first: what is left then is not read
        self._data(key).unlink(missing_ok=True)

    def open(self, key: str, manifest: dict[str, Any]) -> FeatureMap:
        """An entry's features, memory-mapped.

        Raises:
            StaleFeatures: they are not what was written.
        """
        from safetensors import SafetensorError, safe_open

        from encoders.features import FeatureMap

        data, name = self._data(key), self.path(key).name
        if not data.exists() or data.stat().st_size != manifest["bytes"]:
            raise StaleFeatures(
                f"feature store: {data} is missing or cut short; delete {name} to extract again"
            )
        self._check(data, name, manifest)
        try:
            with safe_open(data, "pt") as file:
                values, times = file.get_tensor("values"), file.get_tensor("times")
        except SafetensorError as error:
            raise StaleFeatures(
                f"feature store: {data} is damaged ({error}); delete {name} to extract again"
            ) from error
        stride = manifest["stride"]
        return FeatureMap(values[None], (stride[0], stride[1]), times)

    def begin(self, requests: Sequence[FeatureRequest], origin: Origin) -> Entries:
        """See :meth:`encoders.FeatureStore.begin`."""
        from encoders.entry import DTYPES, Entries, EntryFile, manifest_of

        if not self._swept:
            sweep(self.folder, ".*.partial", f"*{TENSORS}")
        self._swept = True
        partials = {request: partial_of(self._data(request.key)) for request in requests}
        with ExitStack() as opening:
            files = []
            for request, partial in partials.items():
                opening.callback(partial.unlink, missing_ok=True)
                file = opening.enter_context(partial.open("wb"))
                files.append(EntryFile(file, origin, DTYPES[request.dtype]))
            stack = opening.pop_all()

        def keep() -> None:
            data, manifests = {}, {}
            for (request, partial), entry in zip(partials.items(), files, strict=True):
                text = json.dumps(manifest_of(request, entry), indent=2)
                said = partial_of(self.path(request.key))
                stack.callback(said.unlink, missing_ok=True)
                said.write_text(text, encoding="utf-8")
                entry.file.close()
                data[partial] = self._data(request.key)
                manifests[said] = self.path(request.key)
            place({**data, **manifests})

        return Entries(files, keep, stack.close)

    def _check(self, data: Path, name: str, manifest: dict[str, Any]) -> None:
        """Compare an entry's tensors with their hash, once while they stay the same file."""
        about = data.stat()
        seen = data.name, about.st_mtime_ns, about.st_size
        if seen not in self._checked and file_sha256(data) != manifest["sha256"]:
            raise StaleFeatures(
                f"feature store: {data} is damaged (its sha256 differs from {name}); delete "
                f"{name} to extract again"
            )
        self._checked.add(seen)

    def _data(self, key: str) -> Path:
        return self.path(key).with_suffix(TENSORS)
