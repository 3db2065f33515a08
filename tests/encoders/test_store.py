"""The feature store: filed under everything, whole or not there, never stale."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path

import pytest
import torch

from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.manifests import StaleFeatures
from encoders.release import file_sha256
from encoders.store import FeatureRequest, FeatureStore

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


def entry_files(store: FeatureStore) -> tuple[Path, Path]:
    (manifest,) = (store.folder / "entries").glob("*.json")
    return manifest, manifest.with_suffix(".safetensors")


def test_damage_is_refused(tmp_path: Path, request_: FeatureRequest, features: FeatureMap) -> None:
    store = FeatureStore(tmp_path / "store")
    store.write(request_, "clip.mp4", features)
    manifest, data = entry_files(store)
    whole, text = data.read_bytes(), manifest.read_text()
    data.write_bytes(whole[:-1])
    with pytest.raises(StaleFeatures, match=r"cut short; delete .*\.json to extract again"):
        store.read(request_)
    data.write_bytes(b"\xff" * len(whole))
    with pytest.raises(StaleFeatures, match="is damaged"):
        store.read(request_)
    data.unlink()
    with pytest.raises(StaleFeatures, match="is missing"):
        store.read(request_)
    data.write_bytes(whole)
    manifest.write_text(text[: len(text) // 2])
    with pytest.raises(StaleFeatures, match="is not a manifest"):
        store.read(request_)
    manifest.write_text(text.replace('"schema_version": 2', '"schema_version": 99'))
    with pytest.raises(StaleFeatures, match="schema version 99"):
        store.read(request_)
    manifest.write_text(text.replace('"layer": "8"', '"layer": "4"'))
    with pytest.raises(StaleFeatures, match="was edited"):
        store.read(request_)


def test_verify_finds_a_flipped_bit(
    tmp_path: Path, request_: FeatureRequest, features: FeatureMap
) -> None:
    store = FeatureStore(tmp_path / "store")
    store.write(request_, "clip.mp4", features)
    assert store.verify() == []
    _, data = entry_files(store)
    content = bytearray(data.read_bytes())
    content[-1] ^= 1
    data.write_bytes(content)
    assert store.verify() == [request_.key]


def test_an_interrupted_write_leaves_nothing_that_is_read(
    tmp_path: Path,
    request_: FeatureRequest,
    features: FeatureMap,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    store = FeatureStore(tmp_path / "store")
    for survives in (0, 1):
        calls = iter(range(9))

        def fsync(_: int, calls: object = calls, survives: int = survives) -> None:
            if next(calls) == survives:  # type: ignore[call-overload]
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
    manifest = json.loads((store.folder / "entries" / f"{other.key}.json").read_text())
    assert manifest["request"]["times"] == [0.0, 0.1, 0.2]
    data = store.folder / "entries" / f"{other.key}.safetensors"
    assert data.stat().st_size == manifest["bytes"]


def test_one_clip_at_a_time(tmp_path: Path, request_: FeatureRequest, features: FeatureMap) -> None:
    two = dataclasses.replace(features, values=features.values.expand(2, -1, -1, -1, -1))
    with pytest.raises(ValueError, match="one clip at a time, got a batch of 2"):
        FeatureStore(tmp_path / "store").write(request_, "clip.mp4", two)
