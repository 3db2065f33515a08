"""What a feature store knows of an entry, and whether it is still as it was written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from encoders.identity import EncoderIdentity
from encoders.release import file_sha256
from registry.seal import is_sealed

SCHEMA_VERSION = 2
KEYED = 1  # what keys are made with; other requests, other keys
UNSEALED = 1  # the schema of before a manifest held a hash of itself


@dataclass(frozen=True)
class FeatureRequest:
    """Features of which frames of which clip by which encoder.

    Args:
        encoder: see :class:`EncoderIdentity`.
        source_sha256: hash of the clip's file, or of the frames' bytes.
        frames: indices of the frames, counted by decoding.
        times: seconds of each frame.
        frame_size: (height, width) of the frames that the encoder was given.
        dtype: of the stored values; ``int8`` has a scale and a mean for each channel.
        grid: cells on a side that maps are pooled to at most; as they are where not given.
    """

    encoder: EncoderIdentity
    source_sha256: str
    frames: tuple[int, ...]
    times: tuple[float, ...]
    frame_size: tuple[int, int]
    dtype: Literal["float16", "bfloat16", "float32", "int8"] = "float16"
    grid: int | None = None

    @cached_property
    def told(self) -> dict[str, Any]:
        """What a manifest says of it: without a grid as before there were any."""
        told = asdict(self)
        return told if self.grid is not None else {k: v for k, v in told.items() if k != "grid"}

    @cached_property
    def key(self) -> str:
        """SHA-256 of the request, the name of its files."""
        text = json.dumps(self.told, sort_keys=True)
        return hashlib.sha256(f"{KEYED}:{text}".encode()).hexdigest()


class StaleFeatures(ValueError):
    """An entry does not fit what asks for it; the message says what differs and what to do."""


def load_manifest(path: Path, read: Callable[[Path], bytes] = Path.read_bytes) -> dict[str, Any]:
    """The manifest of a file.

    Args:
        path: of the file.
        read: what takes the manifest out of it.

    Raises:
        StaleFeatures: it is none, of another schema, or not as it was written.
    """
    try:
        manifest = json.loads(read(path))
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


def require_made_of(
    manifest: dict[str, Any], entry: str, source: Path, encoder: EncoderIdentity | None
) -> None:
    """Refuse features of another file than ``source`` now is, or of another encoder.

    Raises:
        StaleFeatures: what differs.
    """
    request = manifest["request"]
    if request["source_sha256"] != file_sha256(source):
        raise StaleFeatures(
            f"feature store: {entry} was made from another file than {source} now is; extract again"
        )
    for name, value in asdict(encoder).items() if encoder else ():
        if request["encoder"][name] != value:
            raise StaleFeatures(
                f"feature store: {entry} has {name} {request['encoder'][name]}, this encoder "
                f"{value}; extract again"
            )


def require_sealed(where: str, manifest: dict[str, Any]) -> None:
    """Refuse a manifest of a shard that is not as it was written.

    Raises:
        StaleFeatures: it differs from its seal.
    """
    must = manifest.get("schema_version") != UNSEALED
    if not is_sealed(manifest, must):
        raise StaleFeatures(f"feature store: {where} is damaged or was edited; extract again")
