import json
from dataclasses import replace

import pyarrow.parquet as pq
import pytest

from encoders.frozen import ENCODERS
from tests.shared.small_clips import cells  # noqa: F401
from vidphys.cli import main
from vidphys.cli.atlas import AtlasConfig, _settings, publish
from vidphys.cli.from_atlas import with_atlas
from vidphys.cli.train import TrainConfig
from vidphys.data.rendered import RenderSettings, render_folder
from vidphys.errors import InputError
from vidphys.probing.atlas import AtlasUnit, run_unit, settings_of
from vidphys.runs.folder import RunFolder
from vidphys.runs.sealed import read_sealed, write_sealed

TARGETS = ("position", "direction", "contact")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = tmp_path_factory.mktemp("atlas") / "clips"
    settings = RenderSettings("gravity", "rgb", 16, 6, 20, 32, 0)
    render_folder(RunFolder.open(folder, {"cells": [], "seeds": [0]}), settings)
    return folder


def run_atlas(clips, out, *encoders):
    features = out.with_name("features")
    config = AtlasConfig(clips, out=out, store=features, targets=TARGETS, kept=("int8",))
    settings = _settings(config)
    reports = []
    run = RunFolder.open(out, settings_of(settings, encoders, [0]))
    for name in encoders:
        run_unit(run.path, AtlasUnit(name, 0), settings, lambda *said: reports.append(said))
    return run, reports


def test_an_atlas_is_mapped_extended_and_told(clips, tmp_path, cells, monkeypatch):  # noqa: F811
    for table in (ENCODERS._parts, ENCODERS._modules):
        monkeypatch.setitem(table, "others", table["cells"])
    run, reports = run_atlas(clips, tmp_path / "run", "cells")
    assert any(name.endswith("disorder") for name, _, _ in reports) is False  # each frame alone
    _, again = run_atlas(clips, tmp_path / "run", "cells")
    assert not again  # it is done
    run, _ = run_atlas(clips, tmp_path / "run", "cells", "others")
    sentences = publish(run)
    assert [s.split()[1] for s in sentences] == list(TARGETS)
    said = read_sealed(run.path / "atlas.json", "an atlas", "", 1)
    assert {c["target"] for c in said["choices"]} == set(TARGETS)
    assert {d["encoder"] for d in said["depths"]} == {"cells", "others"}
    rows = pq.read_table(run.path / "records.parquet").to_pylist()
    metrics = {r["metric"] for r in rows if r["cell"].startswith("others/4/position")}
    assert {"score", "score_low", "selectivity_high", "depth", "calibration"} <= metrics
    assert {"kept/int8", "kept/int8_high", "bytes/int8"} <= metrics
    assert metrics & {"form/cells", "form/pooled", "form/softmax"}
    controls = {m for m in metrics if m.startswith("control/") and not m.endswith(("low", "high"))}
    assert len(controls) == 7
    assert all(r["value"] > 0 for r in rows if r["metric"] == "ms_per_clip")
    page = (run.path / "report.html").read_text()
    assert "Is the middle special?" in page and page.count("<svg") == 2
    chosen = with_atlas(TrainConfig(clips, from_atlas=run.path, quiet=True))
    best = next(c for c in said["choices"] if c["target"] == "position")
    assert (chosen.encoder, chosen.layers) == (best["encoder"], (best["layer"],))
    for form, readout in (("cells", "refined"), ("pooled", "pooled"), ("softmax", "attention")):
        choices = [{**best, "form": form}]
        (tmp_path / form).mkdir()
        write_sealed(tmp_path / form / "atlas.json", {"choices": choices}, 1)
        given = TrainConfig(clips, from_atlas=tmp_path / form, quiet=True)
        assert with_atlas(given).readout == readout
        assert with_atlas(replace(given, readout="refined")).readout == "refined"
    assert with_atlas(TrainConfig(clips)).readout == "refined"
    with pytest.raises(InputError, match="--layers: would have no effect: the atlas chooses"):
        with_atlas(TrainConfig(clips, from_atlas=run.path, layers=(1,)))
    with pytest.raises(InputError, match="--encoder hiera: would have no effect"):
        with_atlas(TrainConfig(clips, from_atlas=run.path, encoder="hiera"))
    with pytest.raises(InputError, match="no atlas.json there"):
        with_atlas(TrainConfig(clips, from_atlas=clips))
    assert json.loads((run.path / "run.json").read_text())["settings"]["cells"] == [
        "cells",
        "others",
    ]


@pytest.mark.slow
def test_features_come_from_the_store_the_second_time(clips, tmp_path, cells):  # noqa: F811
    run_atlas(clips, tmp_path / "one", "cells")
    _, reports = run_atlas(clips, tmp_path / "two", "cells")
    assert not [name for name, _, _ in reports if name.endswith(("clips", "random-weights"))]
    clips_of = _settings(AtlasConfig(clips, out=tmp_path / "one")).shown
    assert clips_of is _settings(AtlasConfig(clips, out=tmp_path / "two")).shown
    tables = [
        pq.read_table(tmp_path / name / "parts" / "cells-s0.episodes.parquet")
        for name in ("one", "two")
    ]
    assert tables[0].equals(tables[1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--targets", "velocty"], "did you mean 'velocity'"),
        (["--encoders", "dino-tony"], "did you mean 'dino-tiny'"),
        (["--folds", "9"], "16 clips; --folds 9 needs at least 18"),
        (["--readout", "cubic"], "--readout cubic: use one of linear, cells, pooled, softmax"),
        (["--each", "0"], "--each 0: must be at least 1"),
        (["--readout", "two-stage"], "--each 2: --readout two-stage reads 3 frames at least"),
        (["--rates", "0.01"], "--rates: would have no effect: --readout linear is not trained"),
        (["--readout", "attention", "--widths", "0"], "--widths and --rates must be above 0"),
    ],
)
def test_what_is_wrong_is_said_before_any_work(clips, tmp_path, capsys, options, message):
    assert main(["atlas", str(clips), "--out", str(tmp_path / "run"), *options]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
