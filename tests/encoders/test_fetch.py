"""Fetching weights: from a server that speaks the hub's protocol, gone on with where it broke."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from safetensors.torch import save

from encoders.download import download
from encoders.known_weights import KNOWN
from encoders.weights import fetch, find_weights
from tests.shared.hub_server import COMMIT, hub_server

DATA = bytes(range(256)) * 4000  # a megabyte
FILES = {
    "config.json": b'{"architecture": "vit_small_patch14_dinov2"}',
    "model.safetensors": save({"w": torch.arange(4_000_000.0)}),
}


def run_fetch(server, folder, tmp_path, name="dinov2-small"):
    told = {"HF_ENDPOINT": server, "HF_HUB_CACHE": str(tmp_path / "cache"), "HF_HUB_OFFLINE": "0"}
    return subprocess.run(
        [sys.executable, "-m", "vidphys", "weights", "fetch", name, "--weights", folder],
        env=os.environ | told | {"HF_HUB_DISABLE_XET": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_the_hubs_client_gets_a_release_through_a_redirect_and_a_break(tmp_path):
    folder = tmp_path / "weights"
    with hub_server(FILES) as server:
        server.break_after = 14_000_000  # the client keeps whole blocks of ten million bytes
        done = run_fetch(server.address, str(folder), tmp_path)
        assert done.returncode == 0, done.stderr
        assert "licence: Apache-2.0" in done.stdout
        gone_on = [told for _, path, told in server.asked if path.startswith("/cdn/")]
        assert any(told and int(told[6:-1]) >= 10_000_000 for told in gone_on)
        paths = [path for _, path, _ in server.asked if "/resolve/" in path]
        assert paths and all(f"/resolve/{COMMIT}/" in path for path in paths)
    for name, data in FILES.items():
        assert (folder / "dinov2-small" / name).read_bytes() == data
    find_weights("dinov2-small", folder)
    # the server is gone: what is here needs none, and what is not says what to copy where
    again = run_fetch("http://127.0.0.1:9", str(folder), tmp_path)
    assert again.returncode == 0 and "sha256" in again.stdout
    other = run_fetch("http://127.0.0.1:9", str(tmp_path / "other"), tmp_path / "no")
    assert other.returncode == 2 and "Traceback" not in other.stderr
    said = " ".join(other.stderr.split())
    assert "copy config.json and model.safetensors" in said and "dinov2-small and run" in said


def test_what_is_behind_a_door_is_fetched_and_then_found_by_its_name(tmp_path):
    beside = {"preprocessor_config.json": b'{"size": {"height": 64, "width": 64}}'}
    with hub_server(FILES | beside) as server:
        done = run_fetch(server.address, str(tmp_path / "w"), tmp_path, "hf:owner/model")
        assert done.returncode == 0, done.stderr
        assert "https://huggingface.co/owner/model" in done.stdout  # its licence
        other = run_fetch(server.address, str(tmp_path / "w"), tmp_path, "nobody:model")
    for name, data in (FILES | beside).items():
        assert (tmp_path / "w" / "hf--owner--model" / name).read_bytes() == data
    find_weights("hf:owner/model", tmp_path / "w")
    assert other.returncode == 2 and "hf:NAME" in other.stderr


def test_a_file_is_gone_on_with_where_it_broke_off(tmp_path):
    target, shown = tmp_path / "w.pth", []
    with hub_server({"w.pth": DATA}) as server:
        server.break_after = 700_000
        with pytest.raises(ConnectionError, match="the same command goes on"):
            download(f"{server.address}/w.pth", target)
        assert not target.exists()
        download(f"{server.address}/w.pth", target, lambda *told: shown.append(told))
    assert [told for _, _, told in server.asked] == [None, "bytes=700000-"]
    assert target.read_bytes() == DATA and shown[-1] == (len(DATA), len(DATA))
    assert [file.name for file in tmp_path.iterdir()] == ["w.pth"]


def test_a_part_of_another_file_is_not_gone_on_with(tmp_path):
    with hub_server({"w.pth": DATA}) as server:
        server.break_after = 700_000
        with pytest.raises(ConnectionError):
            download(f"{server.address}/w.pth", tmp_path / "w.pth")
        server.files["w.pth"] = DATA[::-1]
        download(f"{server.address}/w.pth", tmp_path / "w.pth")
    assert (tmp_path / "w.pth").read_bytes() == DATA[::-1]


def test_a_file_that_is_not_the_one_its_name_says_is_not_kept(tmp_path, monkeypatch):
    digest = hashlib.sha256(DATA).hexdigest()
    with hub_server({"s3d.pth": DATA}) as server:
        url = f"{server.address}/s3d.pth"
        monkeypatch.setitem(KNOWN, "s3d", replace(KNOWN["s3d"], url=url))
        with pytest.raises(ValueError, match=r"expected one that begins with d76dad2f; nothing"):
            fetch("s3d", tmp_path)
        assert not list(tmp_path.iterdir())
        monkeypatch.setitem(KNOWN, "s3d", replace(KNOWN["s3d"], url=url, begins=digest[:8]))
        assert fetch("s3d", tmp_path).sha256 == digest
        asked = len(server.asked)
        fetch("s3d", tmp_path)  # it is here
        assert len(server.asked) == asked
        (tmp_path / KNOWN["s3d"].file).write_bytes(b"damaged")
        assert fetch("s3d", tmp_path).sha256 == digest
