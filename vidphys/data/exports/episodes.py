"""Episodes: numbers frame by frame, of a track, of a rollout, or the features of a clip."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from encoders.identity import EncoderIdentity
from encoders.store import FeatureRequest, FeatureStore
from registry.seal import unsealed_arrays
from vidphys.data.formats.tables import arrays_of, headers_of
from vidphys.errors import InputError

ROLLED = {
    "rollout": "roll on under the law that held",
    "changed": "roll on under a law that was changed",
}
STATE = "observation.state"


@dataclass(frozen=True)
class Episode:
    """Numbers frame by frame.

    Args:
        name: of it among the others.
        task: what it is, in words.
        times: seconds ``(t,)``.
        columns: arrays ``(t, ...)`` by name.
        parts: names of the numbers of those columns that are vectors ``(t, k)``.
        facts: what else is known of it.
    """

    name: str
    task: str
    times: np.ndarray
    columns: Mapping[str, np.ndarray]
    parts: Mapping[str, tuple[str, ...]]
    facts: Mapping[str, Any]


def episodes_of(path: Path) -> Iterator[Episode]:
    """What lies in the folder of a rollout, or in a feature store.

    Raises:
        InputError: neither does.
    """
    if (path / "rollout.npz").is_file():
        return _rolled(path / "rollout.npz")
    if (path / "entries").is_dir() or (path / "shards").is_dir():
        return _stored(FeatureStore(path))
    raise InputError(
        f"{path}: neither a finished `vidphys rollout` nor a feature store of `vidphys extract`"
    )


def _rolled(path: Path) -> Iterator[Episode]:
    try:
        held = unsealed_arrays(arrays_of(path, list(headers_of(path))))
        sure = {"confidence": held["confidence"]} if "confidence" in held else {}
        track = _moving("track", "follow what moves", held["times"], held["track"], sure)
    except (OSError, ValueError, EOFError, KeyError, RuntimeError, zlib.error, BadZipFile) as error:
        raise InputError(f"{path}: damaged ({error}); roll out again") from error
    yield track
    for name, task in ROLLED.items():
        if name in held:
            yield _moving(name, task, held["rollout_times"], held[name], {})


def _moving(
    name: str, task: str, times: np.ndarray, places: np.ndarray, more: Mapping[str, np.ndarray]
) -> Episode:
    _, bodies, space = places.shape
    names = tuple(f"{axis}{body + 1}" for body in range(bodies) for axis in "xyz"[:space])
    columns = {STATE: places.reshape(len(places), -1), **more}
    every = tuple(str(body + 1) for body in range(bodies))
    parts = {STATE: names} | {key: tuple(f"{key}{b}" for b in every) for key in more}
    return Episode(name, task, times, columns, parts, {})


def _stored(store: FeatureStore) -> Iterator[Episode]:
    for manifest in store.entries():
        about = manifest["request"]
        encoder = EncoderIdentity(**about["encoder"])
        listed = {name: tuple(about[name]) for name in ("frames", "times", "frame_size")}
        features = store.read(FeatureRequest(**{**about, **listed, "encoder": encoder}))
        if features is None:
            continue
        facts = {
            "clip": manifest["source"],
            "clip_sha256": about["source_sha256"],
            "encoder": encoder.name,
            "layer": encoder.layer,
            "stride": list(features.stride),
        }
        values = features.values[0].float().numpy()
        name = f"{Path(manifest['source']).stem}-{encoder.name}-{encoder.layer}"
        task = f"{encoder.name}, layer {encoder.layer}"
        columns = {"observation.features": values}
        unique = f"{name}-{manifest['key'][:8]}"
        yield Episode(unique, task, features.times.numpy(), columns, {}, facts)
