"""A folder of features on disk, filed under everything that they depend on.

::

    STORE/entries/<key>.json           the manifest; renamed into place last
    STORE/entries/<key>.safetensors    values (t, c, h, w) and times, memory-mapped when read
    STORE/shards/                      both of many entries; see :mod:`encoders.shards`

The key is the hash of the request, so other weights, layers or frames never meet by accident. An
entry is written as two files; :meth:`FeatureStore.pack` puts many into shards, as git does with
its objects, so that a store of millions has few files. Its own files count before a shard.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from encoders.entry import Entries, EntryFile, new_entry, placed
from encoders.features import FeatureMap, FeatureStream, streamed, stride_of
from encoders.identity import EncoderIdentity
from encoders.manifests import (
    SCHEMA_VERSION,
    FeatureRequest,
    StaleFeatures,
    load_manifest,
    require_sealed,
)
from encoders.release import file_sha256
from encoders.shards import DamagedShard, Loose, Row, Shards
from registry.seal import sealed

STALE_SECONDS = 3600.0  # without a change, after which a partial file is nobody's
DTYPES = {"float16": torch.float16, "bfloat16": torch.bfloat16, "float32": torch.float32}

__all__ = ["DTYPES", "FeatureRequest", "FeatureStore", "StaleFeatures"]


class FeatureStore:
    """Reads and writes one store; several processes may write to it at once.

    Args:
        folder: made at the first write.

    Example:
        >>> import tempfile
        >>> who = EncoderIdentity("mine", 1, "0" * 64, "none", "last", 32, "float32")
        >>> request = FeatureRequest(who, "1" * 64, (0, 1), (0.0, 0.1), (32, 32))
        >>> made = FeatureMap(torch.ones(1, 2, 8, 2, 2), (16.0, 16.0), torch.tensor([0.0, 0.1]))
        >>> store = FeatureStore(Path(tempfile.mkdtemp()))
        >>> for _ in range(2):
        ...     features = store.get(request, "clip.mp4", lambda: made)
        ...
        >>> tuple(features.values.shape), store.hit_rate
        ((1, 2, 8, 2, 2), 0.5)
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.shards = Shards(folder / "shards")
        self._checked: set[tuple[str, int, int]] = set()
        self._swept = False
        self.hits = 0
        self.misses = 0

    @property
    def hit_rate(self) -> float | None:
        """Share of the requests of this object that were on disk; ``None`` before the first."""
        asked = self.hits + self.misses
        return self.hits / asked if asked else None

    def get(
        self, request: FeatureRequest, source: str, encode: Callable[[], FeatureMap]
    ) -> FeatureMap:
        """The features of ``request``, from disk or else by ``encode()``, which is then stored.

        Args:
            request: what is wanted.
            source: label of the clip for people (a path).
            encode: makes the features of one episode.
        """
        found = self.read(request)
        if found is not None:
            self.hits += 1
            return found
        self.misses += 1
        self.write(request, source, encode())
        written = self.read(request)
        assert written is not None
        return written

    def get_layers(
        self,
        requests: Mapping[str, FeatureRequest],
        source: str,
        encode: Callable[[Sequence[str]], Iterator[FeatureStream]],
        made: Mapping[str, Any] | None = None,
    ) -> dict[str, FeatureMap]:
        """Several layers of a clip, those that are not on disk by ``encode(layers)``.

        Args:
            requests: by layer.
            source: see :meth:`get`.
            encode: makes the features of some layers; see :class:`encoders.FrozenEncoder`.
            made: see :meth:`write_layers`.
        """
        missing = [layer for layer, request in requests.items() if not self.has(request)]
        for stream in encode(missing) if missing else ():
            self.write_layers(requests, source, stream, made)
        self.misses += len(missing)
        self.hits += len(requests) - len(missing)
        found = {layer: self.read(request) for layer, request in requests.items()}
        return {layer: features for layer, features in found.items() if features is not None}

    def has(self, request: FeatureRequest) -> bool:
        """Whether there is an entry of ``request``; it is not looked into."""
        return self._manifest(request.key).exists() or self.shards.has(request.key)

    def shape_of(self, request: FeatureRequest) -> tuple[int, ...]:
        """``(t, c, h, w)`` of an entry that is there, as its manifest says it."""
        found = self._found(request.key)
        return () if found is None else tuple(found[0]["shape"])

    def read(self, request: FeatureRequest) -> FeatureMap | None:
        """The features of ``request``, memory-mapped, or ``None`` where the store has none.

        Raises:
            StaleFeatures: the entry is damaged, or of another schema.
        """
        found = self._found(request.key)
        if found is None:
            return None
        manifest, opened = found
        if manifest["request"] != json.loads(json.dumps(asdict(request))):
            path = self._manifest(request.key)
            raise StaleFeatures(f"feature store: {path} was edited; delete it to extract again")
        try:
            return opened()
        except StaleFeatures:
            if self._manifest(request.key).exists():
                raise
            moved = self._found(request.key)  # into a shard, by another process, just now
            if moved is None:
                raise
            return moved[1]()

    def entries(self) -> Iterator[dict[str, Any]]:
        """Manifests, each with its ``key``: of entries of their own, then of those in shards."""
        own = set()
        for path in self._own():
            own.add(path.stem)
            yield {"key": path.stem, **load_manifest(path)}
        for row in self.shards.rows():
            if row.key not in own:
                yield {"key": row.key, **row.manifest}

    def pack(self, least: int = 1) -> int:
        """Put entries of their own into shards; returns how many.

        Damaged ones stay as they are. What is read or written at the same time is not disturbed.

        Args:
            least: of such entries; where there are fewer, nothing is done.
        """
        paths = [*islice(self._own(), least)]
        if len(paths) < least or not paths:
            return 0
        return self.shards.add(self._loose(), self._drop)

    def delete(self, encoder: str, layer: str | None = None) -> int:
        """Take out what an encoder made, of one layer or all; returns how many entries that were.

        Args:
            encoder: its name.
            layer: of it.
        """
        count = self.shards.delete(encoder, layer)
        for path in [*self._own()]:
            made_by = load_manifest(path)["request"]["encoder"]
            if made_by["name"] == encoder and layer in (None, made_by["layer"]):
                self._drop(path.stem)
                count += 1
        return count

    def counts(self) -> Iterator[tuple[str, str, int, int]]:
        """Encoder, layer, entries and bytes; the same pair may come twice."""
        yield from self.shards.counts()
        for path in self._own():
            manifest = load_manifest(path)
            made_by = manifest["request"]["encoder"]
            yield made_by["name"], made_by["layer"], 1, manifest["bytes"]

    def _own(self) -> Iterator[Path]:
        """Manifests that are files of their own."""
        return (self.folder / "entries").glob("*.json")

    def _loose(self) -> Iterator[Loose]:
        for path in self._own():
            with suppress(StaleFeatures, OSError):
                manifest, data = load_manifest(path), self._data(path.stem).read_bytes()
                if hashlib.sha256(data).hexdigest() == manifest["sha256"]:
                    yield Loose(path.stem, manifest, data)

    def _drop(self, key: str) -> None:
        self._manifest(key).unlink(missing_ok=True)  # first: what is left then is not read
        self._data(key).unlink(missing_ok=True)

    def _found(self, key: str) -> tuple[dict[str, Any], Callable[[], FeatureMap]] | None:
        """An entry's manifest, and what opens its tensors."""
        path = self._manifest(key)
        try:
            manifest = load_manifest(path) if path.exists() else None
        except StaleFeatures:
            manifest = None
            if path.exists():  # else it was put into a shard just now, by another process
                raise
        if manifest is not None:
            return manifest, partial(self._open, path, manifest)
        row = self.shards.row(key)
        return None if row is None else (row.manifest, partial(self._of_shard, row))

    def _of_shard(self, row: Row) -> FeatureMap:
        require_sealed(f"{self.shards.folder}, entry {row.key[:12]}", row.manifest)
        try:
            values, times = self.shards.tensors(row)
        except DamagedShard as error:
            encoder = row.manifest["request"]["encoder"]["name"]
            raise StaleFeatures(
                f"feature store: entry {row.key[:12]}: {error}; `vidphys store delete` the "
                f"encoder {encoder} to extract again"
            ) from error
        stride = row.manifest["stride"]
        return FeatureMap(values[None], (stride[0], stride[1]), times)

    def open(self, key: str, source: Path, encoder: EncoderIdentity | None = None) -> FeatureMap:
        """Features by their key, for use without the encoder, after the checks that guard it.

        Args:
            key: from :meth:`entries`.
            source: the clip as it is now.
            encoder: what the features should come from, if that is known.

        Raises:
            StaleFeatures: missing or damaged, of another clip than ``source`` now is, or made by
                another encoder than ``encoder``.
        """
        found = self._found(key)
        if found is None:
            raise StaleFeatures(f"feature store {self.folder}: no entry {key}; extract it first")
        manifest, opened = found
        request = manifest["request"]
        if request["source_sha256"] != file_sha256(source):
            raise StaleFeatures(
                f"feature store: entry {key[:12]} was made from another file than {source} now "
                "is; extract again"
            )
        for field, value in asdict(encoder).items() if encoder else ():
            if request["encoder"][field] != value:
                raise StaleFeatures(
                    f"feature store: entry {key[:12]} has {field} {request['encoder'][field]}, "
                    f"this encoder {value}; extract again"
                )
        return opened()

    def write(self, request: FeatureRequest, source: str, features: FeatureMap) -> None:
        """Store the features of one clip, whole or not at all.

        Raises:
            ValueError: more than one episode, or values that the dtype cannot hold.
        """
        layer = request.encoder.layer
        self.write_layers({layer: request}, source, streamed(layer, features))

    def write_layers(
        self,
        requests: Mapping[str, FeatureRequest],
        source: str,
        stream: FeatureStream,
        made: Mapping[str, Any] | None = None,
    ) -> None:
        """Store features of one clip as they come in, an entry for each layer.

        Args:
            requests: by layer.
            source: see :meth:`get`.
            stream: of some of the layers.
            made: what else is known of how they were made, for the manifest.

        Raises:
            ValueError: values that the dtype cannot hold.
        """
        chosen = [requests[layer] for layer in stream.layers]
        with self.begin(chosen, source, stream.size, stream.times, made) as entries:
            for piece in stream.pieces:
                entries.add(piece)

    def begin(
        self,
        requests: Sequence[FeatureRequest],
        source: str,
        size: tuple[int | float, int | float],
        times: Tensor,
        made: Mapping[str, Any] | None = None,
    ) -> Entries:
        """Entries to be filled piece by piece, which are there once all of them is.

        Args:
            requests: of layers with the same feature frames.
            source, made: see :meth:`write_layers`.
            size: of the frames in pixels, (height, width).
            times: of the feature frames, seconds.
        """
        self._sweep()
        new = [new_entry(self._data(r.key), times, DTYPES[r.dtype], source) for r in requests]

        def commit(files: Sequence[EntryFile]) -> None:
            for request, file in zip(requests, files, strict=True):
                manifest = {
                    "schema_version": SCHEMA_VERSION,
                    "source": source,
                    "request": asdict(request),
                    "made": dict(made or {}),
                    "stride": list(stride_of(size, file.grid)),
                    **file.about(),
                }
                with placed(self._manifest(request.key)) as partial:
                    partial.write_text(json.dumps(sealed(manifest), indent=2), encoding="utf-8")

        return Entries(new, commit)

    def verify(self) -> list[str]:
        """Keys of the entries whose tensors do not have the recorded hash any more."""
        bad = []
        for path in self._own():
            data = self._data(path.stem)
            if not data.exists() or file_sha256(data) != load_manifest(path)["sha256"]:
                bad.append(path.stem)
        for row in self.shards.rows():
            try:
                self._of_shard(row)
            except StaleFeatures:
                bad.append(row.key)
        return bad

    def _sweep(self) -> None:
        """Delete, once, what killed processes left half-written and nobody has touched since."""
        stale = () if self._swept else (self.folder / "entries").glob(".*.partial")
        self._swept = True
        for path in stale:
            with suppress(OSError):  # another process sweeps too
                if time.time() - path.lstat().st_mtime > STALE_SECONDS:
                    path.unlink()

    def _manifest(self, key: str) -> Path:
        return self.folder / "entries" / f"{key}.json"

    def _data(self, key: str) -> Path:
        return self._manifest(key).with_suffix(".safetensors")

    def _open(self, path: Path, manifest: dict[str, Any]) -> FeatureMap:
        from safetensors import SafetensorError, safe_open

        data = path.with_suffix(".safetensors")
        if not data.exists() or data.stat().st_size != manifest["bytes"]:
            raise StaleFeatures(
                f"feature store: {data} is missing or cut short; delete {path.name} to extract "
                "again"
            )
        self._check(data, path, manifest)
        try:
            with safe_open(data, "pt") as file:
                values, times = file.get_tensor("values"), file.get_tensor("times")
        except SafetensorError as error:
            raise StaleFeatures(
                f"feature store: {data} is damaged ({error}); delete {path.name} to extract again"
            ) from error
        stride = manifest["stride"]
        return FeatureMap(values[None], (stride[0], stride[1]), times)

    def _check(self, data: Path, path: Path, manifest: dict[str, Any]) -> None:
        """Compare an entry's tensors with their hash, once while they stay the same file."""
        about = data.stat()
        seen = data.name, about.st_mtime_ns, about.st_size
        if seen not in self._checked and file_sha256(data) != manifest["sha256"]:
            raise StaleFeatures(
                f"feature store: {data} is damaged (its sha256 differs from {path.name}); delete "
                f"{path.name} to extract again"
            )
        self._checked.add(seen)
