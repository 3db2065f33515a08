"""Z3, Z7: tensors are held to their header; weights are checked before anything is kept."""

from __future__ import annotations

import json
import struct
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import save, save_file

from encoders import weights
from encoders.known_weights import KNOWN
from encoders.release import INDEX, file_sha256, release_files, shards_of
from encoders.tensors import MOST_TENSORS, read_tensors
from encoders.weights import fetch, find_weights, lock

GOOD = save({"w": torch.arange(12.0).reshape(3, 4), "b": torch.zeros(3, dtype=torch.int64)})


def with_header(held: object, data: bytes = bytes(64)) -> bytes:
    header = held if isinstance(held, bytes) else json.dumps(held).encode()
    return struct.pack("<Q", len(header)) + header + data


def entry(dtype: str = "F32", shape: object = (4,), offsets: object = (0, 16)) -> dict:
    return {"w": {"dtype": dtype, "shape": shape, "data_offsets": offsets}}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "a header of 0 B"),
        (b"\xff" * 8, "a header of 18446744073709551615 B"),
        (struct.pack("<Q", 99_000_000) + b"{}", "a header of 99000000 B"),
        (struct.pack("<Q", 2) + b"[]", "is not a safetensors file"),
        (with_header(b"{"), "is not a safetensors file"),
        (with_header(b'{"a": ' * 5000), "is not a safetensors file"),
        (with_header(entry("F8_E4M3", (4,), (0, 4))), "'w' is of 'F8_E4M3'"),
        (with_header(entry("O")), "'w' is of 'O'"),
        (with_header(entry(shape=(2**33, 2**33))), "is not of 16 B"),
        (with_header(entry(shape=(-4,))), "is not of 16 B"),
        (with_header(entry(shape=(2**32, 2**32, 0), offsets=(0, 0))), ""),
        (with_header(entry(shape="4")), ""),
        (with_header(entry(offsets=(0, 2**40))), "is not of"),
        (with_header(entry(offsets=(16, 0))), "is not of"),
        (with_header(entry(), b""), "is not of 16 B"),
        (with_header({"w": {"dtype": "F32"}}), "is not a safetensors file"),
        (with_header({"w": 3}), "is not a safetensors file"),
    ],
)
def test_z03_a_header_is_held_to_what_its_bytes_can_hold(tmp_path, data, said):
    path = tmp_path / "a.safetensors"
    path.write_bytes(data)
    with pytest.raises(ValueError, match="a.safetensors") as caught:
        read_tensors(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_z03_a_million_tensors_are_refused_before_they_are_made(tmp_path):
    one = b'"%d":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}'
    path = tmp_path / "a.safetensors"
    path.write_bytes(with_header(b"{" + b",".join(one % k for k in range(10**6)) + b"}"))
    began = time.monotonic()
    with pytest.raises(ValueError, match=f"more than {MOST_TENSORS} tensors"):
        read_tensors(path)
    assert time.monotonic() - began < 10


def test_z03_what_is_sound_is_read(tmp_path):
    path = tmp_path / "a.safetensors"
    path.write_bytes(GOOD)
    assert torch.equal(read_tensors(path)["w"], torch.arange(12.0).reshape(3, 4))


@pytest.mark.parametrize(
    "shard",
    ["../../x", "../x.safetensors", "/tmp/x.safetensors", "a/b.safetensors", "C:x.safetensors",
     "..\\x.safetensors", "x.pt", "", ".safetensors", "x\0.safetensors", 3, None],
)  # fmt: skip
def test_z07_an_index_names_files_beside_it_only(tmp_path, shard):
    (tmp_path / INDEX).write_text(json.dumps({"weight_map": {"w": shard}}))
    (tmp_path / "config.json").write_text("{}")
    for ask in (lambda: shards_of(tmp_path / INDEX), lambda: release_files(tmp_path)):
        with pytest.raises(ValueError, match="is not an index of shards") as caught:
            ask()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["[" * 10**5, "{", "[]", '{"weight_map": 3}', "\xff"])
def test_z10_an_index_or_a_lock_that_is_none_is_one_line(tmp_path, text):
    (tmp_path / INDEX).write_text(text, encoding="latin-1")
    with pytest.raises(ValueError, match="is not an index of shards"):
        shards_of(tmp_path / INDEX)
    (tmp_path / "sam2_hiera_tiny.lock.json").write_text(text, encoding="latin-1")
    with pytest.raises(ValueError, match="is not a lock"):
        find_weights("hiera", tmp_path)


@pytest.fixture
def hub(tmp_path, monkeypatch) -> dict[str, Path]:
    """What a hub gives instead of what was asked for, by the name of the file."""
    given: dict[str, Path] = {}

    def from_hub(_repository: str, file: str, revision: str | None) -> tuple[Path, str]:
        if file not in given:
            raise FileNotFoundError(file)
        return given[file], revision or "c0ffee"

    monkeypatch.setattr(weights, "from_hub", from_hub)
    save_file({"w": torch.ones(3)}, tmp_path / "other.safetensors")
    given["model.safetensors"] = tmp_path / "other.safetensors"
    return given


def test_z07_what_is_not_the_pinned_file_is_neither_kept_nor_locked(tmp_path, hub):
    folder = tmp_path / "weights"
    folder.mkdir()
    (folder / "sam2_hiera_tiny.safetensors").write_bytes(b"mine")
    with pytest.raises(ValueError, match="what came has sha256 .*nothing was kept"):
        fetch("hiera", folder)
    assert [file.name for file in folder.iterdir()] == ["sam2_hiera_tiny.safetensors"]
    assert (folder / "sam2_hiera_tiny.safetensors").read_bytes() == b"mine"


def test_z07_what_was_locked_is_not_replaced_by_another(tmp_path, hub, monkeypatch):
    monkeypatch.setitem(KNOWN, "hiera", replace(KNOWN["hiera"], sha256=()))
    folder = tmp_path / "weights"
    held = fetch("hiera", folder)
    assert held.sha256 == file_sha256(hub["model.safetensors"])
    save_file({"w": torch.zeros(3)}, tmp_path / "third.safetensors")
    hub["model.safetensors"] = tmp_path / "third.safetensors"
    assert fetch("hiera", folder) == held  # which is here
    whole = held.path.read_bytes()
    held.path.write_bytes(b"damaged")
    with pytest.raises(ValueError, match="nothing was kept"):
        fetch("hiera", folder)
    held.path.write_bytes(whole)
    assert find_weights("hiera", folder).sha256 == held.sha256


def test_z07_a_shard_is_written_nowhere_else(tmp_path, hub):
    (tmp_path / "config.json").write_text("{}")
    (tmp_path / "index.json").write_text(json.dumps({"weight_map": {"w": "../../x"}}))
    hub |= {"config.json": tmp_path / "config.json", INDEX: tmp_path / "index.json"}
    hub["../../x"] = hub.pop("model.safetensors")
    with pytest.raises(ValueError, match="is not an index of shards"):
        fetch("dinov2-small", tmp_path / "deep" / "weights")
    assert not [file for file in tmp_path.rglob("x*")]
    assert not list((tmp_path / "deep" / "weights").iterdir())


def test_z07_a_lock_is_written_in_place_of_a_link_and_not_through_it(tmp_path):
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "w.safetensors").write_bytes(GOOD)
    (tmp_path / "w.lock.json").symlink_to(tmp_path / "mine")
    lock(tmp_path / "w.safetensors", None)
    assert (tmp_path / "mine").read_text() == "mine"
