"""The faster precision is taken, and its error is told."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch

from encoders.features import FeatureMap
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
