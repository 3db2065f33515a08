"""`vidphys fit`: the diagnosed model is trained on its tracks; only what has an effect is asked."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.shared.bouncing import thrown
from vidphys.cli import main
from vidphys.diagnose.recordings.tables import write_tracks
from vidphys.diagnose.telling.answers import answer
from vidphys.play.sources import FitSource
from vidphys.runs import checkpoint
from vidphys.runs.atomic import write_json


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """A table of tracks, and what a diagnosis of it specified."""
    root, motion = tmp_path_factory.mktemp("diagnosed"), thrown()
    write_tracks(root / "tracks.csv", motion)
    write_json(root / "specification.json", answer(motion, False, 0.3).specification)
    return root / "tracks.csv", root / "specification.json"


def fit(diagnosed, out, *more):
    tracks, specification = diagnosed
    told = ["--specification", str(specification), "--out", str(out), "--quiet"]
    return main(["fit", str(tracks), *told, *more])


def test_the_specified_terms_are_trained_and_the_rest_foretold(diagnosed, tmp_path):
    assert fit(diagnosed, tmp_path / "run", "--steps", "3") == 0
    rows = pq.read_table(tmp_path / "run" / "records.parquet").to_pylist()
    found = {row["metric"]: row["value"] for row in rows}
    assert found["forecast_rmse"] < found["forecast_rmse_persistence"]
    meta = checkpoint.load(tmp_path / "run" / "checkpoints" / "heads" / "specified.json")[1]
    assert meta["terms"] == json.loads(diagnosed[1].read_text())["terms"]
    assert meta["step"] == 3 and meta["bodies"] == 1


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--steps", "0"], "--steps 0: must be at least 1"),
        (["--train-share", "0"], "--train-share 0.0: must be above 0"),
        (["--stop", "2"], "--start 0 --stop 2"),
    ],
)
def test_options_that_make_no_sense(diagnosed, tmp_path, capsys, more, words):
    assert fit(diagnosed, tmp_path / "run", *more) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_specification_of_other_bodies_is_refused(diagnosed, tmp_path, capsys):
    held = json.loads(diagnosed[1].read_text())
    write_json(tmp_path / "other.json", {**held, "bodies": 2, "mass": [1.0, 1.0]})
    assert fit((diagnosed[0], tmp_path / "other.json"), tmp_path / "run") == 2
    assert "fit: the specification is of 2 bodies" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_what_would_have_no_effect_is_not_taken(diagnosed, tmp_path, capsys):
    for option in ("--encoder", "--device", "--widths"):
        assert fit(diagnosed, tmp_path / "run", option, "cpu") == 2
        assert option in capsys.readouterr().err


def test_a_plane_is_of_two_dimensions(diagnosed, tmp_path, capsys):
    held = json.loads(diagnosed[1].read_text())
    axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    told = {**held, "space": 3, "origin": [*held["origin"], 0.0], "plane": axes}
    write_json(tmp_path / "space.json", told)
    assert fit((diagnosed[0], tmp_path / "space.json"), tmp_path / "run") == 2
    assert "plane: is of a scene in 2 dimensions, this one has 3" in capsys.readouterr().err


def test_a_table_in_space_is_fitted_and_rolled_in_the_plane_that_it_was_told_in(
    diagnosed, tmp_path
):
    flat, axes = thrown(), [[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]
    motion = replace(flat, positions=flat.positions @ np.array(axes))
    write_tracks(tmp_path / "space.csv", motion)
    held = json.loads(diagnosed[1].read_text())
    write_json(tmp_path / "plane.json", {**held, "plane": axes})
    told = (tmp_path / "space.csv", tmp_path / "plane.json")
    assert fit(told, tmp_path / "run", "--steps", "3") == 0
    given = ["rollout", str(tmp_path / "run"), str(tmp_path / "space.csv"), "--quiet"]
    assert main([*given, "--out", str(tmp_path / "on")]) == 0
    with np.load(tmp_path / "on" / "rollout.npz") as rolled:
        assert rolled["rollout"].shape[-1] == 2
    stage = FitSource(tmp_path / "run", tmp_path / "space.csv").stage("tracks/specified")
    assert stage.start.q.shape[-1] == 2
