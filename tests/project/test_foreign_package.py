"""A package from outside, installed as a distribution: its parts through the verbs of the shell.

|         | ladder              | train           | extract         | diagnose    | stress |
|---------|---------------------|-----------------|-----------------|-------------|--------|
| encoder | rung edges/screened | --encoder edges | --encoder edges | reads none  | a row  |
| term    | in the head         | in the head     | has no dynamics | its menu*   | a row  |
| scene   | --scene             | its clips       | its clips       | its tracks  | a row  |
| format  | reads no files      | .stack, .marks  | .stack          | .marks      | none*  |

`diagnose` weighs the terms of its menu; a specification may name any, and `fit` trains it. The
matrix of `stress` has no file to ask a format about; ``check_format`` asks it here.
"""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path

import numpy as np
import pytest

from dynamics import HEADS, to_config
from encoders.frozen import ENCODERS, load_encoder
from encoders.store import FeatureStore
from tests.shared.small_studies import TINY, with_short_lyapunov_times
from vidphys.cli import main
from vidphys.data.formats import FORMATS, ClipFormat, format_of
from vidphys.data.video import ClipSelection, open_video
from vidphys.presets import PRESETS
from vidphys.scenes import SCENES
from vidphys.testing import check_encoder, check_format, check_head, check_scene, check_term

DISTRIBUTION = "vidphys-foreign-example"
INSTALLED = any(found.name == DISTRIBUTION for found in importlib.metadata.distributions())
pytestmark = pytest.mark.skipif(
    not INSTALLED, reason="uv pip install --no-deps --editable tests/foreign"
)
SOURCE = f"{DISTRIBUTION} 0.1.0"


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three clips of the foreign scene."""
    out = tmp_path_factory.mktemp("foreign") / "clips"
    size = ["--clips", "3", "--frames", "16", "--image", "32"]
    assert main(["render", "--out", str(out), "--scene", "screened-pair", *size, "--quiet"]) == 0
    return out


@pytest.fixture(scope="module")
def strange(rendered: Path) -> Path:
    """The same clips in the foreign formats: frames in a .stack, places in a .marks beside it."""
    folder = rendered.parent / "strange"
    folder.mkdir()
    for clip in sorted((rendered / "clips").glob("*.avi")):
        video = open_video(clip, ClipSelection())
        with (folder / f"{clip.stem}.stack").open("wb") as file:
            np.savez(file, frames=video.frames, rate=1 / video.interval)
        rows = np.loadtxt(clip.with_suffix(".csv"), delimiter=",", skiprows=1)
        write_trk(folder / f"{clip.stem}.marks", rows[:, 1:].reshape(len(rows), 2, 2), rows[1, 0])
    return folder


def write_trk(path: Path, places: np.ndarray, interval: float) -> None:
    head = {"unit": "mm", "rate": 1 / interval}
    lines = [json.dumps(head), *(json.dumps({"at": at.tolist()}) for at in 1e3 * places)]
    path.write_text("\n".join(lines) + "\n")


def settings(run: Path) -> dict:
    return json.loads((run / "run.json").read_text())["settings"]


# checkers


def test_all_parts_pass_their_checkers(strange: Path) -> None:
    check_encoder("edges")
    check_term(HEADS["screened"].potentials[0])
    check_head(HEADS["screened"], exchangeable=True)
    check_scene("screened-pair")
    check_format("trk", strange / "00000.marks")
    check_format("stack", strange / "00000.stack")


# what is not ours is listed, and told of


def test_parts_are_listed_with_their_source(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["parts"]) == 0
    listed = capsys.readouterr().out
    for name in ("edges", "yukawa", "screened", "screened-pair", "trk", "stack"):
        assert f"{name} ({SOURCE})" in listed


def test_a_name_that_is_nearly_right_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "--out", "x", "--scene", "screened-pear"]) == 2
    assert "did you mean 'screened-pair'" in capsys.readouterr().err
    assert main(["ladder", "--out", "x", "--cells", "edgs"]) == 2
    assert "did you mean 'edges'" in capsys.readouterr().err


def test_another_version_is_another_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    first = load_encoder("edges", {}).identity
    source = ENCODERS.source("edges")
    monkeypatch.setattr(ENCODERS, "source", lambda name: type(source)(DISTRIBUTION, "0.2.0"))
    assert load_encoder("edges", {}).identity != first


# the verbs


def test_render_tells_where_the_scene_is_from(rendered: Path) -> None:
    assert settings(rendered)["sources"] == {"scene screened-pair": SOURCE}


@pytest.mark.parametrize("which", ["rendered", "strange"])
def test_extract(which: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Encoder, scene and both formats."""
    folder = request.getfixturevalue(which)
    clips = [str(p) for p in sorted(folder.rglob("0000*")) if format_of(p, ClipFormat)]
    store = ["--out", str(tmp_path / "store"), "--encoder", "edges", "--options", "cell=8"]
    assert len(clips) == 3
    assert main(["extract", *clips, *store, "--quiet"]) == 0
    (one, *_) = FeatureStore(tmp_path / "store").entries()
    assert SOURCE in one["request"]["encoder"]["preprocessing"] and one["shape"][2:] == [4, 4]


def test_extract_by_path_and_a_wrong_option(
    rendered: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = str(rendered / "clips" / "00000.avi")
    path = ["--encoder", "vidphys_foreign_example.encoder:Edges", "--out", str(tmp_path / "store")]
    assert main(["extract", clip, *path, "--quiet"]) == 0
    assert main(["extract", clip, *path, "--resolution", "64"]) == 2
    assert "takes no resolution; it takes cell" in capsys.readouterr().err


@pytest.mark.parametrize("which", [pytest.param("rendered", marks=pytest.mark.slow), "strange"])
def test_train(which: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Encoder, term, scene and both formats."""
    run, store = tmp_path / "run", tmp_path / "store"
    quick = ["--readout", "attention", "--steps", "12", "--head-steps", "4", "--shift", "1"]
    where = ["--store", str(store), "--out", str(run), "--quiet"]
    mine = ["--encoder", "edges", "--heads", "screened"]
    assert main(["train", str(request.getfixturevalue(which)), *quick, *mine, *where]) == 0
    found = settings(run)["sources"]
    formats = {"format stack": SOURCE, "format trk": SOURCE} if which == "strange" else {}
    assert found == {"encoder edges": SOURCE, "head screened": SOURCE, **formats}
    clip = next(
        p for p in request.getfixturevalue(which).rglob("00000*") if format_of(p, ClipFormat)
    )
    rolled = ["--head", "screened", "--beyond", "0.2", "--out", str(tmp_path / "on"), "--quiet"]
    assert main(["rollout", str(run), str(clip), *rolled]) == 0


def test_diagnose(strange: Path, tmp_path: Path) -> None:
    """Scene and format; what it finds is the menu's business."""
    scene = SCENES["screened-pair"]()
    import torch

    start, params = scene.sample(1, torch.Generator().manual_seed(0))
    states = scene.simulate(start, params, 2000, 20).states
    write_trk(tmp_path / "long.marks", states.q[0].numpy(), 20 * scene.dt)
    run = tmp_path / "run"
    assert main(["diagnose", str(tmp_path / "long.marks"), "--out", str(run), "--quiet"]) == 0
    assert settings(run)["sources"] == {"format trk": SOURCE}
    assert (run / "diagnosis.json").is_file()


QUICK = ["--preset", "quick", "--seeds", "1", "--workers", "1", "--quiet"]


@pytest.mark.parametrize(
    ("cells", "sources"),
    [
        pytest.param(
            ["oracle/screened", "--scene", "screened-pair"],
            {"head screened": SOURCE, "scene screened-pair": SOURCE},
            marks=pytest.mark.slow,
        ),
        (
            ["edges/screened", "--scene", "screened-pair"],
            {"head screened": SOURCE, "scene screened-pair": SOURCE, "encoder edges": SOURCE},
        ),
    ],
)
def test_ladder(
    cells: list[str], sources: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Encoder, term and scene."""
    monkeypatch.setitem(PRESETS, "quick", TINY)
    with_short_lyapunov_times(monkeypatch)
    run = tmp_path / "run"
    assert main(["ladder", "--cells", *cells, "--out", str(run), *QUICK]) == 0
    assert settings(run)["sources"] == sources
    import pyarrow.parquet as pq

    records = pq.read_table(run / "records.parquet").to_pylist()
    assert {r["system"] for r in records} == {"screened-pair"}
    assert any(r["metric"] == "inversion_nmse" and r["status"] == "ok" for r in records)


def test_stress(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Encoder, term, head and scene have rows of their own, none of them silently wrong."""
    run = tmp_path / "run"
    assert main(["stress", "--axes", "foreign", "--out", str(run), "--quiet"]) == 0
    cells = json.loads((run / "verdicts.json").read_text())["cells"]
    assert {cell["system"].split()[0] for cell in cells} == {"term", "head", "scene", "encoder"}
    assert all(SOURCE in cell["system"] and cell["allowed"] for cell in cells)


def test_a_part_that_is_none_of_ours_is_in_no_table_of_the_study() -> None:
    from vidphys.experiments.ladder import LADDER

    assert "screened" not in LADDER.settings["heads"]
    assert to_config(HEADS["screened"])["potentials"][0]["term"] == "yukawa"
    assert isinstance(FORMATS["stack"], ClipFormat)
