"""The faster precision is taken, and its error is told."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from encoders.features import FeatureMap
from encoders.frozen.catalogue import load_encoder
from encoders.store import FeatureStore
from tests.shared.small_clips import write_clip
from vidphys.cli import main
from vidphys.data import precision
from vidphys.data.precision import faster
from vidphys.data.video import ClipSelection, open_video


@pytest.mark.parametrize("slow", ["float32", "bfloat16"])
def test_the_faster_one_is_taken_with_its_error(tmp_path, slow, monkeypatch):
    write_clip(tmp_path / "c.avi", 4, table=False)
    video = open_video(tmp_path / "c.avi", ClipSelection())
    clock = [0.0]
    monkeypatch.setattr(precision, "time", SimpleNamespace(perf_counter=lambda: clock[0]))

    class Fake:
        def __init__(self, dtype):
            self.dtype = dtype

        def encode_layers(self, frames, times, layers):
            clock[0] += 0.2 if self.dtype == slow else 0.1
            assert frames.shape[:3] == (1, 4, 3) and len(times) == 4
            off = {"1": 0.0, "2": 0.01 if self.dtype == "bfloat16" else 0.0}
            ones = torch.ones(1, 4, 2, 2, 2)
            return {k: FeatureMap(ones * (1 + off[k]), (1.0, 1.0), times) for k in layers}

    found = faster(Fake, ("1", "2"), video)
    assert found.encoder.dtype != slow and found.error == pytest.approx(0.01, rel=1e-3)
    assert found.short == (slow == "float32") and "feature error of 0.01" in str(found)


def test_the_verb_tells_it_and_keeps_it(tmp_path, capsys):
    write_clip(tmp_path / "c.avi", 4, table=False)
    out = ["--out", str(tmp_path / "s"), "--fast", "--quiet"]
    assert main(["extract", str(tmp_path / "c.avi"), *out]) == 0
    assert "times the speed of float32 here" in capsys.readouterr().out
    (kept,) = FeatureStore(tmp_path / "s").entries()
    short = kept["request"]["encoder"]["dtype"] == "bfloat16"
    assert ("feature_error" in kept["made"]) == short
    assert main(["extract", str(tmp_path / "c.avi"), *out, "--dtype", "float32"]) == 2
    assert "--fast chooses it" in capsys.readouterr().err


@pytest.mark.parametrize("shared", [False, True])
def test_a_run_in_fewer_bits_keeps_the_error_of_its_first_window(
    tmp_path, shared, capsys, monkeypatch
):
    """Of 16 frames at least; entries of another precision, and a run that makes none, have none."""
    for name, count in (("a", 18), ("b", 4)):
        write_clip(tmp_path / "clips" / f"{name}.avi", count, table=False)
    (tmp_path / "clips" / "0.avi").write_bytes(b"none" if shared else b"")
    if not shared:
        (tmp_path / "clips" / "0.avi").unlink()
    command = ["extract", str(tmp_path / "clips"), "--out", str(tmp_path / "s"), "--quiet"]
    short = [*command, "--dtype", "bfloat16", "--layers", "1", "3", *["--shared"] * shared]
    assert main(short) == shared
    assert "feature error" in capsys.readouterr().out
    video = open_video(tmp_path / "clips" / "a.avi", ClipSelection(stop=16))
    frames = torch.from_numpy(np.stack([*video.frames])).permute(0, 3, 1, 2)[None]
    maps = [
        load_encoder("dino-tiny", {"dtype": dtype}).encode_layers(
            frames, torch.from_numpy(video.times), ("1", "3")
        )
        for dtype in ("float32", "bfloat16")
    ]
    exact, found = ([each[layer].values for layer in "13"] for each in maps)
    away = [float((f - e).norm() / e.norm()) for f, e in zip(found, exact, strict=True)]
    kept = [*FeatureStore(tmp_path / "s").entries()]
    assert len(kept) == 4
    for entry in kept:
        assert entry["made"]["feature_error"] == pytest.approx(max(away), rel=5e-3) and max(away)
    monkeypatch.setattr(precision, "error_of", lambda *_: 1 / 0)
    assert main(short) == shared
    assert main(command) == (2 if shared else 0)
    whole = [e for e in FeatureStore(tmp_path / "s").entries() if e not in kept]
    assert all("feature_error" not in entry["made"] for entry in whole)
