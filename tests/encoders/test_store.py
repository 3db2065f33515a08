"""The feature store: filed under everything, whole or not there, never stale."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.manifests import StaleFeatures
from encoders.release import file_sha256
from encoders.store import FeatureRequest, FeatureStore
from tests.shared.stored import as_older, fill, made, parts_of, put_together, request

IDENTITY = EncoderIdentity("fake", 1, "a" * 64, "none", "8", 128, "float32")


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    path = tmp_path / "clip.mp4"
    path.write_bytes(b"some video")
    return path


@pytest.fixture
def request_(clip: Path) -> FeatureRequest:
    return FeatureRequest(
        encoder=IDENTITY,
        source_sha256=file_sha256(clip),
        frames=(0, 2, 4),
        times=(0.0, 0.1, 0.2),
        frame_size=(48, 32),
        dtype="float32",
    )


@pytest.fixture
def features() -> FeatureMap:
    times = torch.tensor([0.0, 0.1, 0.2], dtype=torch.float64)
    return FeatureMap(torch.randn(1, 3, 5, 4, 2), (12.0, 16.0), times)


def never() -> FeatureMap:
    raise AssertionError("encoded again")


def test_a_miss_then_hits(tmp_path: Path, request_: FeatureRequest, features: FeatureMap) -> None:
    store = FeatureStore(tmp_path / "store")
    assert store.hit_rate is None
    first = store.get(request_, "clip.mp4", lambda: features)
    second = FeatureStore(tmp_path / "store").get(request_, "clip.mp4", never)
    for found in (first, second, store.get(request_, "clip.mp4", never)):
        assert torch.equal(found.values, features.values)
        assert torch.equal(found.times, features.times)
        assert found.stride == features.stride
    assert store.hit_rate == 0.5


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(EncoderIdentity)])
def test_another_encoder_is_another_entry(
    tmp_path: Path, request_: FeatureRequest, features: FeatureMap, field: str
) -> None:
    store = FeatureStore(tmp_path / "store")
    store.write(request_, "clip.mp4", features)
    value = getattr(IDENTITY, field)
    other = value + 1 if isinstance(value, int) else value + "x"
    encoder = dataclasses.replace(IDENTITY, **{field: other})
    assert store.read(dataclasses.replace(request_, encoder=encoder)) is None


@pytest.mark.parametrize(
    "change",
    [
        {"source_sha256": "b" * 64},
        {"frames": (0, 2, 5)},
        {"times": (0.0, 0.1, 0.3)},
        {"frame_size": (48, 33)},
        {"dtype": "float16"},
    ],
)
def test_another_request_is_another_entry(
    tmp_path: Path, request_: FeatureRequest, features: FeatureMap, change: dict[str, object]
) -> None:
    store = FeatureStore(tmp_path / "store")
    store.write(request_, "clip.mp4", features)
    assert store.read(request_) is not None
    assert store.read(dataclasses.replace(request_, **change)) is None  # type: ignore[arg-type]


def test_half_precision_is_kept_as_such(
    tmp_path: Path, request_: FeatureRequest, features: FeatureMap
) -> None:
    store = FeatureStore(tmp_path / "store")
    half = dataclasses.replace(request_, dtype="float16")
    found = store.get(half, "clip.mp4", lambda: features)
    assert found.values.dtype == torch.float16
    assert torch.equal(found.values, features.values.half())
    too_large = dataclasses.replace(features, values=features.values * 1e6)
    other = dataclasses.replace(half, frames=(1, 2, 3))
    with pytest.raises(ValueError, match="not finite in float16; use float32"):
        store.write(other, "clip.mp4", too_large)
    assert store.read(other) is None


def entry_file(store: FeatureStore) -> Path:
    (entry,) = (store.folder / "entries").iterdir()
    return entry


def test_damage_is_refused(tmp_path: Path, request_: FeatureRequest, features: FeatureMap) -> None:
    store = FeatureStore(tmp_path / "store")
    store.write(request_, "clip.mp4", features)
    entry = entry_file(store)
    tensors, said = parts_of(entry)
    entry.write_bytes(entry.read_bytes()[:-1])
    with pytest.raises(StaleFeatures, match=r"is not a manifest .*; delete it to extract again"):
        store.read(request_)
    put_together(entry, b"", said)
    with pytest.raises(StaleFeatures, match=r"damaged .*; delete .*\.entry to extract again"):
        store.read(request_)
    put_together(entry, b"\xff" * len(tensors), said)
    with pytest.raises(StaleFeatures, match="is damaged"):
        store.read(request_)
    put_together(entry, tensors, said[: len(said) // 2])
    with pytest.raises(StaleFeatures, match="is not a manifest"):
        store.read(request_)
    put_together(entry, tensors, said.replace(b'"schema_version": 2', b'"schema_version": 99'))
    with pytest.raises(StaleFeatures, match="schema version 99"):
        store.read(request_)
    put_together(entry, tensors, said.replace(b'"layer": "8"', b'"layer": "4"'))
    with pytest.raises(StaleFeatures, match="was edited"):
        store.read(request_)


def test_an_older_store_is_read_checked_and_packed(tmp_path: Path) -> None:
    store = fill(tmp_path, range(4))
    as_older(tmp_path)
    assert torch.equal(store.read(request(0)).values, made(0).values)
    assert len([*store.entries()]) == 4 and store.verify() == []
    tensors = tmp_path / "entries" / f"{request(1).key}.safetensors"
    tensors.write_bytes(tensors.read_bytes()[:-1])
    with pytest.raises(StaleFeatures, match=r"cut short; delete .*\.json to extract again"):
        store.read(request(1))
    tensors.unlink()
    with pytest.raises(StaleFeatures, match="is missing"):
        store.read(request(1))
    assert store.verify() == [request(1).key]
    store.write(request(2), "clip.mp4", made(5))  # again, which counts before the older one
    assert len([*store.entries()]) == 4
    assert torch.equal(store.read(request(2)).values, made(5).values)
    assert store.drop(request(3).key) and not store.has(request(3))
    assert store.pack() == 2
    assert [path.name for path in (tmp_path / "entries").iterdir()] == [f"{request(1).key}.json"]
    assert torch.equal(store.read(request(2)).values, made(5).values)


@pytest.mark.parametrize("place", [-1, 200])
def test_verify_finds_a_flipped_bit(
    tmp_path: Path, request_: FeatureRequest, features: FeatureMap, place: int
) -> None:
    store = FeatureStore(tmp_path / "store")
    store.write(request_, "clip.mp4", features)
    assert store.verify() == []
    entry = entry_file(store)
    content = bytearray(entry.read_bytes())
    content[place] ^= 1
    entry.write_bytes(content)
    assert store.verify() == [request_.key]


def test_an_interrupted_write_leaves_nothing_that_is_read(
    tmp_path: Path,
    request_: FeatureRequest,
    features: FeatureMap,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    store = FeatureStore(tmp_path / "store")

    def fsync(_: int) -> None:
        raise OSError("disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fsync)
        with pytest.raises(OSError, match="disk is full"):
            store.get(request_, "clip.mp4", lambda: features)
    assert store.read(request_) is None
    assert not list(store.folder.rglob("*.partial"))
    assert torch.equal(store.get(request_, "clip.mp4", lambda: features).values, features.values)


def test_opening_by_key_guards_source_and_encoder(
    tmp_path: Path, clip: Path, request_: FeatureRequest, features: FeatureMap
) -> None:
    store = FeatureStore(tmp_path / "store")
    store.write(request_, str(clip), features)
    (listed,) = store.entries()
    assert torch.equal(store.open(listed["key"], clip, IDENTITY).values, features.values)
    newer = dataclasses.replace(IDENTITY, code_version=2)
    with pytest.raises(StaleFeatures, match="code_version 1, this encoder 2; extract again"):
        store.open(listed["key"], clip, newer)
    with pytest.raises(StaleFeatures, match="no entry"):
        store.open("0" * 64, clip)
    clip.write_bytes(b"cut again")
    with pytest.raises(StaleFeatures, match="another file"):
        store.open(listed["key"], clip)


def test_entries_are_listed_with_their_manifests(
    tmp_path: Path, request_: FeatureRequest, features: FeatureMap
) -> None:
    store = FeatureStore(tmp_path / "store")
    other = dataclasses.replace(request_, frames=(1, 3, 5))
    for each in (request_, other):
        store.write(each, "clip.mp4", features)
    rows = [*store.entries()]
    assert {r["key"] for r in rows} == {request_.key, other.key}
    assert {tuple(r["request"]["frames"]) for r in rows} == {(0, 2, 4), (1, 3, 5)}
    assert all(r["shape"] == [3, 5, 4, 2] for r in rows)
    tensors, said = parts_of(store.folder / "entries" / f"{other.key}.entry")
    assert json.loads(said)["request"]["times"] == [0.0, 0.1, 0.2]
    assert len(tensors) == json.loads(said)["bytes"]


def test_one_clip_at_a_time(tmp_path: Path, request_: FeatureRequest, features: FeatureMap) -> None:
    two = dataclasses.replace(features, values=features.values.expand(2, -1, -1, -1, -1))
    with pytest.raises(ValueError, match="one clip at a time, got a batch of 2"):
        FeatureStore(tmp_path / "store").write(request_, "clip.mp4", two)


WITHOUT_TORCH = """
import sys
from pathlib import Path
import numpy as np
from encoders import FeatureArrays, FeatureRequest, FeatureStore, EncoderIdentity

who = EncoderIdentity("mine", 1, "0" * 64, "none", "last", 32, "float32")
values = np.arange(64, dtype=np.float32).reshape(2, 8, 2, 2)
store = FeatureStore(Path(sys.argv[1]))
for number, dtype in enumerate(("float16", "bfloat16", "float32")):
    request = FeatureRequest(who, f"{number}" * 64, (0, 1), (0.0, 0.1), (32, 48), dtype)
    store.write(request, "clip.mp4", FeatureArrays(values, (16.0, 24.0), np.array([0.0, 0.1])))
for packed in (0, store.pack()):
    for number, dtype in enumerate(("float16", "bfloat16", "float32")):
        request = FeatureRequest(who, f"{number}" * 64, (0, 1), (0.0, 0.1), (32, 48), dtype)
        found = store.arrays(request)
        assert np.array_equal(found.values, values) and found.stride == (16.0, 24.0)
        assert found.values.dtype == (np.float16 if dtype == "float16" else np.float32)
        assert found.times.tolist() == [0.0, 0.1]
print("torch" in sys.modules)
"""


def test_arrays_are_written_packed_and_read_without_torch(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH, str(tmp_path)], capture_output=True, text=True
    )
    assert done.stdout == "False\n", done.stderr
    (first,) = (e for e in FeatureStore(tmp_path).entries() if e["request"]["dtype"] == "bfloat16")
    store, key = FeatureStore(tmp_path), first["key"]
    found = store._found(key)[1]().features(first["stride"])
    assert found.values.dtype == torch.bfloat16
    assert torch.equal(found.values.flatten(), torch.arange(64.0).bfloat16())
    assert not store.verify()
