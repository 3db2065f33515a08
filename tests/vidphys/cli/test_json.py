"""What is asked for a script is JSON, and says what the lines say."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.store import FeatureRequest, FeatureStore
from vidphys.cli import main


def answered(capsys: pytest.CaptureFixture[str], *arguments: str) -> object:
    main([*arguments, "--json"])
    return json.loads(capsys.readouterr().out)


def test_parts(capsys):
    found = answered(capsys, "parts")
    assert "gravity" in found["scenes"]["ours"] and "timm" in found["encoders"]["doors"]
    main(["parts"])
    lines = capsys.readouterr().out
    assert all(
        name in lines for held in found.values() for name in (*held["ours"], *held["others"])
    )


def test_a_plan(capsys):
    asked = ("plan", "ladder", "--cells", "oracle", "renderer", "--seeds", "2", "--workers", "3")
    found = answered(capsys, *asked)
    assert {tuple(unit["seeds"]) for unit in found["units"]} == {(0,), (1,)}
    assert found["seconds"] == pytest.approx(sum(unit["seconds"] for unit in found["units"]))
    assert found["wall"]["3"] < found["wall"]["1"]
    assert {unit["how"] for unit in found["units"]} == {"measured"} and found["unknown"] == 0


def test_what_this_machine_has(capsys):
    found = answered(capsys, "doctor")
    assert found["torch"] == torch.__version__.split("+")[0] and found["name taken"] == {}


def test_weights(capsys, tmp_path):
    found = answered(capsys, "weights", "list", "--weights", str(tmp_path))
    by_name = {each["name"]: each for each in found}
    assert by_name["hiera"]["path"] is None and by_name["hiera"]["get it by"]
    assert Path(by_name["dino-tiny"]["path"]).exists()
    assert main(["weights", "check", "--json"]) == 2
    assert "--json goes with list only" in capsys.readouterr().err


def test_a_store(capsys, tmp_path):
    identity = EncoderIdentity("mine", 1, "0" * 64, "none", "last", 32, "float32")
    made = FeatureMap(torch.ones(1, 2, 8, 2, 2), (16.0, 16.0), torch.tensor([0.0, 0.1]))
    for clip in "12":
        request = FeatureRequest(identity, clip * 64, (0, 1), (0.0, 0.1), (32, 32))
        FeatureStore(tmp_path).write(request, "clip.mp4", made)
    (row,) = answered(capsys, "store", "list", str(tmp_path))
    assert (row["encoder"], row["layer"], row["entries"]) == ("mine", "last", 2)
    assert row["bytes"] > 2 * 2 * 8 * 4 * 2  # two entries of two frames in float16
    assert main(["store", "check", str(tmp_path), "--json"]) == 2
    work = "import sys; from vidphys.cli import main; main(sys.argv[1:])"
    said = f"{work}; assert 'torch' not in sys.modules"  # which takes seconds to import
    subprocess.run([sys.executable, "-c", said, "store", "list", str(tmp_path)], check=True)
