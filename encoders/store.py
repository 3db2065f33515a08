"""A folder of features on disk, filed under everything that they depend on.

::

    STORE/entries/     an entry a file; see :mod:`encoders.loose`
    STORE/shards/      many entries together; see :mod:`encoders.shards`

The key is the hash of the request, so other weights, layers or frames never meet by accident. An
entry is written as a file; :meth:`FeatureStore.pack` puts many into shards, as git does with
its objects, so that a store of millions has few files. Its own files count before a shard.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from encoders.grid import size_of
from encoders.identity import EncoderIdentity
from encoders.index import Row
from encoders.loose import LooseEntries
from encoders.manifests import FeatureRequest, StaleFeatures, require_made_of, require_sealed
from encoders.shards import DamagedShard, Shards
from registry import lazily

if TYPE_CHECKING:
    from encoders.arrays import FeatureArrays, Mapped
    from encoders.entry import Entries, Origin
    from encoders.features import DTYPES as DTYPES
    from encoders.features import FeatureMap, FeatureStream

__all__ = ["DTYPES", "FeatureRequest", "FeatureStore", "StaleFeatures"]
# torch is imported where tensors are given or asked for, and for nothing else
__getattr__, __dir__ = lazily(__name__, {"DTYPES": "encoders.features"})


class FeatureStore:
    """Reads and writes one store; several processes may write to it at once.

    Args:
        folder: made at the first write.

    Example:
        >>> import tempfile
        >>> import torch
        >>> from encoders import EncoderIdentity, FeatureMap
        >>> who = EncoderIdentity("mine", 1, "0" * 64, "none", "last", 32, "float32")
        >>> request = FeatureRequest(who, "1" * 64, (0, 1), (0.0, 0.1), (32, 32))
        >>> made = FeatureMap(torch.ones(1, 2, 8, 2, 2), (16.0, 16.0), torch.tensor([0.0, 0.1]))
        >>> store = FeatureStore(Path(tempfile.mkdtemp()))
        >>> _, features = (store.get(request, "clip.mp4", lambda: made) for _ in range(2))
        >>> tuple(features.values.shape), store.hit_rate
        ((1, 2, 8, 2, 2), 0.5)
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.loose, self.shards = LooseEntries(folder / "entries"), Shards(folder / "shards")
        self.hits = self.misses = 0

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
        return self.loose.path(request.key).exists() or self.shards.has(request.key)

    def shape_of(self, request: FeatureRequest) -> tuple[int, ...]:
        """``(t, c, h, w)`` of an entry that is there, as its manifest says it."""
        found = self._found(request.key)
        return () if found is None else tuple(found[0]["shape"])

    def read(self, request: FeatureRequest) -> FeatureMap | None:
        """The features of ``request``, or ``None`` where the store has none.

        They are memory-mapped; those in eight bits become float32 in memory.

        Raises:
            StaleFeatures: the entry is damaged, or of another schema.
        """
        found = self._asked(request)
        return None if found is None else found[0].features(found[1])

    def arrays(self, request: FeatureRequest) -> FeatureArrays | None:
        """As :meth:`read`, for NumPy: torch is not imported.

        Raises:
            StaleFeatures: see :meth:`read`.
        """
        found = self._asked(request)
        return None if found is None else found[0].arrays(found[1])

    def _asked(self, request: FeatureRequest) -> tuple[Mapped, Sequence[float]] | None:
        """What an entry has, and its stride."""
        found = self._found(request.key)
        if found is None:
            return None
        manifest, opened = found
        path = self.loose.path(request.key)
        if manifest["request"] != json.loads(json.dumps(request.told)):
            raise StaleFeatures(f"feature store: {path} was edited; delete it to extract again")
        try:
            return opened(), manifest["stride"]
        except StaleFeatures:
            if path.exists():
                raise
            moved = self._found(request.key)  # into a shard, by another process, just now
            if moved is None:
                raise
            return moved[1](), moved[0]["stride"]

    def entries(self) -> Iterator[dict[str, Any]]:
        """Manifests, each with its ``key``: of entries of their own, then of those in shards."""
        own = set()
        for key in self.loose.present():
            if (manifest := self.loose.manifest(key)) is not None:
                own.add(key)
                yield {"key": key, **manifest}
        for row in self.shards.rows():
            if row.key not in own:
                yield {"key": row.key, **row.manifest}

    def pack(self, least: int = 1) -> int:
        """Put entries of their own into shards; returns how many.

        Damaged ones stay as they are. What is read or written at the same time is not disturbed.

        Args:
            least: of such entries; where there are fewer, nothing is done.
        """
        if len([*islice(self.loose.present(), max(least, 1))]) < max(least, 1):
            return 0
        return self.shards.add(self.loose.whole(), self.loose.drop)

    def delete(self, encoder: str, layer: str | None = None) -> int:
        """Take out what an encoder made, of one layer or all; returns how many entries that were.

        Args:
            encoder: its name.
            layer: of it.
        """
        count = self.shards.delete(encoder, layer)
        for key in [*self.loose.present()]:
            manifest = self.loose.manifest(key)
            made_by = manifest["request"]["encoder"] if manifest is not None else {"name": None}
            if made_by["name"] == encoder and layer in (None, made_by["layer"]):
                self.loose.drop(key)
                count += 1
        return count

    def drop(self, key: str) -> bool:
        """Take out one entry; whether it was there. Its bytes in a shard stay until all are out.

        Args:
            key: from :meth:`entries`.
        """
        loose = self.loose.path(key).exists()
        self.loose.drop(key)
        return self.shards.drop(key) or loose

    def counts(self) -> Iterator[tuple[str, str, int, int]]:
        """Encoder, layer, entries and bytes; the same pair may come twice."""
        yield from self.shards.counts()
        for key in self.loose.present():
            if (manifest := self.loose.manifest(key)) is not None:
                made_by = manifest["request"]["encoder"]
                yield made_by["name"], made_by["layer"], 1, manifest["bytes"]

    def verify(self) -> list[str]:
        """Keys of the entries whose tensors do not have the recorded hash any more."""
        bad = [*self.loose.damaged()]
        for row in self.shards.rows():
            if self.loose.path(row.key).exists():
                continue  # made again since
            try:
                self._of_shard(row)
            except StaleFeatures:
                bad.append(row.key)
        return bad

    def open(self, key: str, source: Path, encoder: EncoderIdentity | None = None) -> FeatureMap:
        """Features by their key, for use without the encoder, after the checks that guard it.

        Args:
            key: from :meth:`entries`.
            source: the clip as it is now.
            encoder: what the features should come from, if that is known.

        Raises:
            StaleFeatures: missing, damaged, of another clip or by another encoder.
        """
        found = self._found(key)
        if found is None:
            raise StaleFeatures(f"feature store {self.folder}: no entry {key}; extract it first")
        manifest, opened = found
        require_made_of(manifest, f"entry {key[:12]}", source, encoder)
        return opened().features(manifest["stride"])

    def write(
        self, request: FeatureRequest, source: str, features: FeatureMap | FeatureArrays
    ) -> None:
        """Store the features of one clip, whole or not at all.

        Raises:
            ValueError: more than one episode, or values that the dtype cannot hold.
        """
        from encoders.arrays import FeatureArrays
        from encoders.entry import Origin

        if isinstance(features, FeatureArrays):
            size = size_of(features.stride, features.values.shape)
            with self.begin([request], Origin(source, size, features.times)) as entries:
                entries.add([features.values])
            return
        from encoders.features import streamed

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
        from encoders.entry import Origin

        chosen = [requests[layer] for layer in stream.layers]
        with self.begin(chosen, Origin(source, stream.size, stream.times, made or {})) as entries:
            for piece in stream.pieces:
                entries.add(piece)

    def begin(self, requests: Sequence[FeatureRequest], origin: Origin) -> Entries:
        """Entries to be filled piece by piece, which are there once all of them is.

        Args:
            requests: of layers with the same feature frames.
            origin: of the features.
        """
        return self.loose.begin(requests, origin)

    def _found(self, key: str) -> tuple[dict[str, Any], Callable[[], Mapped]] | None:
        """An entry's manifest, and what opens its tensors."""
        manifest = self.loose.manifest(key)
        if manifest is not None:
            return manifest, partial(self.loose.open, key, manifest)
        row = self.shards.row(key)
        if row is None:
            return None
        require_sealed(f"{row.index}, entry {row.key[:12]}", row.manifest)
        return row.manifest, partial(self._of_shard, row)

    def _of_shard(self, row: Row) -> Mapped:
        require_sealed(f"{row.index}, entry {row.key[:12]}", row.manifest)
        try:
            return self.shards.tensors(row)
        except DamagedShard as error:
            raise StaleFeatures(
                f"feature store: entry {row.key[:12]}: {error}; `vidphys store delete` the key "
                f"{row.key} to extract again"
            ) from error
