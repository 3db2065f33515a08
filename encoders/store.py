"""A folder of features on disk, filed under everything that they depend on.

::

    STORE/entries/<key>.json           the manifest; renamed into place last
    STORE/entries/<key>.safetensors    values (t, c, h, w) and times, memory-mapped when read
    STORE/index.parquet                one row per manifest; a cache, rebuilt from them

The key is the hash of the request, so other weights, layers or frames never meet by accident.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from encoders.entry import Entries, EntryFile, new_entry, placed
from encoders.features import FeatureMap, FeatureStream, streamed, stride_of
from encoders.identity import EncoderIdentity
from encoders.release import file_sha256
from registry.seal import is_sealed, sealed

SCHEMA_VERSION = 2
STALE_SECONDS = 3600.0  # without a change, after which a partial file is nobody's
UNSEALED = 1  # the schema of before a manifest held a hash of itself
KEYED = 1  # what keys are made with; other requests, other keys
DTYPES = {"float16": torch.float16, "bfloat16": torch.bfloat16, "float32": torch.float32}


@dataclass(frozen=True)
class FeatureRequest:
    """Features of which frames of which clip by which encoder.

    Args:
        encoder: see :class:`EncoderIdentity`.
        source_sha256: hash of the clip's file, or of the frames' bytes.
        frames: indices of the frames, counted by decoding.
        times: seconds of each frame.
        frame_size: (height, width) of the frames that the encoder was given.
        dtype: of the stored values.
    """

    encoder: EncoderIdentity
    source_sha256: str
    frames: tuple[int, ...]
    times: tuple[float, ...]
    frame_size: tuple[int, int]
    dtype: Literal["float16", "bfloat16", "float32"] = "float16"

    @property
    def key(self) -> str:
        """SHA-256 of the request, the name of its files."""
        text = json.dumps(asdict(self), sort_keys=True)
        return hashlib.sha256(f"{KEYED}:{text}".encode()).hexdigest()


class StaleFeatures(ValueError):
    """An entry does not fit what asks for it; the message says what differs and what to do."""


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
        return self._manifest(request.key).exists()

    def shape_of(self, request: FeatureRequest) -> tuple[int, ...]:
        """``(t, c, h, w)`` of an entry that is there, as its manifest says it."""
        return tuple(_load_manifest(self._manifest(request.key))["shape"])

    def read(self, request: FeatureRequest) -> FeatureMap | None:
        """The features of ``request``, memory-mapped, or ``None`` where the store has none.

        Raises:
            StaleFeatures: the entry is damaged, or of another schema.
        """
        path = self._manifest(request.key)
        if not path.exists():
            return None
        manifest = _load_manifest(path)
        if manifest["request"] != json.loads(json.dumps(asdict(request))):
            raise StaleFeatures(f"feature store: {path} was edited; delete it to extract again")
        return self._open(path, manifest)

    def entries(self) -> list[dict[str, Any]]:
        """All manifests, each with its ``key``."""
        paths = sorted((self.folder / "entries").glob("*.json"))
        return [{"key": path.stem, **_load_manifest(path)} for path in paths]

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
        path = self._manifest(key)
        if not path.exists():
            raise StaleFeatures(f"feature store {self.folder}: no entry {key}; extract it first")
        manifest = _load_manifest(path)
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
        return self._open(path, manifest)

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

    def write_index(self) -> Path:
        """Rebuild ``index.parquet``: one row per entry, without the lists of frames."""
        import pyarrow
        from pyarrow import parquet

        rows = [_row(manifest) for manifest in self.entries()]
        path = self.folder / "index.parquet"
        table = pyarrow.Table.from_pylist(rows)
        with placed(path) as partial:
            parquet.write_table(table, partial)
        return path

    def verify(self) -> list[str]:
        """Keys of the entries whose tensors do not have the recorded hash any more."""
        bad = []
        for manifest in self.entries():
            data = self._manifest(manifest["key"]).with_suffix(".safetensors")
            if not data.exists() or file_sha256(data) != manifest["sha256"]:
                bad.append(manifest["key"])
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


def _load_manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        version = manifest["schema_version"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise StaleFeatures(
            f"feature store: {path} is not a manifest ({error}); delete it to extract again"
        ) from error
    if version not in (SCHEMA_VERSION, UNSEALED):
        raise StaleFeatures(
            f"feature store: {path} has schema version {version}, this code reads "
            f"{SCHEMA_VERSION}; use another folder, or delete the store"
        )
    if not is_sealed(manifest, must=version == SCHEMA_VERSION):
        raise StaleFeatures(
            f"feature store: {path} is damaged or was edited; delete it to extract again"
        )
    return manifest


def _row(manifest: dict[str, Any]) -> dict[str, Any]:
    request = manifest["request"]
    return {
        "key": manifest["key"],
        "source": manifest["source"],
        "source_sha256": request["source_sha256"],
        **{f"encoder_{k}": v for k, v in request["encoder"].items()},
        "frames": len(request["frames"]),
        "first_frame": request["frames"][0],
        "last_frame": request["frames"][-1],
        "dtype": request["dtype"],
        "shape": manifest["shape"],
        "bytes": manifest["bytes"],
        "sha256": manifest["sha256"],
    }
