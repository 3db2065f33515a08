"""The road goes on: what a specification names is fitted, rolled, changed, looked at and filmed."""

import json

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from dynamics import Parameters, PhaseState, build, rollout, terms
from vidphys.cli import main
from vidphys.diagnose.explanations.specification import as_specification
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.tables import read_tracks, write_tracks
from vidphys.opened import open_run
from vidphys.reading.fitted import load_fitted
from vidphys.runs.atomic import sha256, write_json
from vidphys.runs.folder import RunFolder

STEP, FRAMES = 1 / 30, 90
LAW = terms.Hamiltonian(potentials=(terms.Pendulum(24.0),), ports=(terms.Drag(rate=0.2),))
SWING = terms.OnArc((0.1, 0.5), (0.6, 0.0), (0.0, -0.6), LAW)
ROUGH = LAW.throughout(rate2=25.0, rate=0.3)  # what the specification starts at


def swung(term=SWING, bodies=1):
    """Tracks of a pendulum that was let go far out."""
    head = build(term, bodies, STEP / 8, 2).double()
    law = Parameters(torch.ones(1).double(), torch.ones(1, bodies).double())
    q = torch.tensor([[[0.1 + 0.6 * np.sin(1.2), 0.5 - 0.6 * np.cos(1.2)]]], dtype=torch.float64)
    start = PhaseState(q.expand(1, bodies, 2), torch.zeros(1, bodies, 2, dtype=torch.float64))
    path = rollout(head, start, law, 8 * FRAMES, STEP / 8, every=8).states.q[:, :FRAMES].numpy()
    return path + 0.001 * np.random.default_rng(0).standard_normal(path.shape)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A diagnosis' folder of a filmed pendulum, the clip, and the run of the fit."""
    root = tmp_path_factory.mktemp("road")
    path, term = swung(), terms.OnArc((0.1, 0.5), (0.6, 0.0), (0.0, -0.6), ROUGH)
    filmed(root / "clip.mp4", path[0, :, 0])
    settings = {"experiment": "diagnose", "input_sha256": sha256(root / "clip.mp4")}
    folder = RunFolder.open(root / "diagnosed", {**settings, "cells": [], "seeds": []})
    write_tracks(folder.path / "tracks.csv", motion_of(path, STEP))
    held = as_specification(term, 1, [0.0, 0.0], {}, True, STEP)
    write_json(folder.path / "specification.json", held)
    tracks, told = folder.path / "tracks.csv", str(folder.path / "specification.json")
    asked = ["fit", str(tracks), "--specification", told, "--out", str(root / "run"), "--quiet"]
    assert main([*asked, "--steps", "5"]) == 0
    return root / "run", root / "clip.mp4", tracks


def filmed(path, places, size=96):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 1 / STEP, (size, size))
    for x, y in places:
        frame = np.full((size, size, 3), 40, np.uint8)
        at = round(size / 2 * (1 + x)), round(size / 2 * (1 - y))
        writer.write(cv2.circle(frame, at, 5, (240, 240, 240), -1))
    writer.release()


def roll(fitted, out, *more):
    return main(["rollout", str(fitted[0]), *more, "--out", str(out), "--quiet"])


def test_a_body_on_an_arc_is_fitted_and_what_is_left_can_be_looked_at(fitted, tmp_path):
    model, run = load_fitted(fitted[0]), open_run(fitted[0])
    assert isinstance(model.term, terms.OnArc)
    found = {row["metric"]: row["value"] for row in run.records.to_pylist()}
    assert found["forecast_rmse"] < 0.005 < found["forecast_rmse_persistence"]
    rate2 = model.head.law.potential.rate2.item() / model.units.seconds**2
    assert rate2 == pytest.approx(24.0, rel=5e-3)
    assert found["pendulum_rate2"] == pytest.approx(rate2)
    assert found["friction_linear"] == pytest.approx(0.2, abs=0.03)
    assert run.head("tracks/specified") is not None
    assert main(["view", str(fitted[0]), "--save", str(tmp_path / "fit.rrd")]) == 0


def test_it_is_rolled_on_from_a_table_and_from_the_clip_alike(fitted, tmp_path, capsys):
    asked = "--beyond", "2", "--law", "length=0.5"
    assert roll(fitted, tmp_path / "table", str(fitted[2]), *asked) == 0
    said = capsys.readouterr()
    assert "the changed law goes beyond what was recorded" in said.err
    assert "the law that held goes" not in said.err
    film = str(tmp_path / "f.mp4")
    assert roll(fitted, tmp_path / "clip", str(fitted[1]), "--beyond", "2", "--video", film) == 0
    table, clip = (np.load(tmp_path / name / "rollout.npz") for name in ("table", "clip"))
    assert np.allclose(table["rollout"], clip["rollout"], atol=1e-3)
    assert "changed" not in clip
    for name, radius in (("rollout", 0.6), ("changed", 0.3)):
        away = np.linalg.norm(table[name] - [0.1, 0.5], axis=-1)
        assert np.abs(away - radius).max() < 1e-5
    times = table["rollout_times"]
    assert times[[0, -1]] == pytest.approx([89 * STEP, 89 * STEP + 2], abs=STEP)
    assert cv2.VideoCapture(film).get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES + 60
    assert main(["view", str(tmp_path / "clip"), "--save", str(tmp_path / "clip.rrd")]) == 0


def test_a_push_takes_it_where_it_shall_be(fitted, tmp_path, capsys):
    there = np.array([0.1 + 0.6 * np.sin(-0.5), 0.5 - 0.6 * np.cos(0.5)])
    assert roll(fitted, tmp_path / "a", "--beyond", "0.3", "--reach", *map(str, there)) == 0
    found = np.load(tmp_path / "a" / "rollout.npz")
    assert np.linalg.norm(found["changed"][-1, 0] - there) < 0.02
    assert np.linalg.norm(found["rollout"][-1, 0] - there) > 0.05
    assert np.allclose(found["changed"][0], found["rollout"][0], atol=1e-6)
    said = capsys.readouterr().out
    assert "with the push: at" in said and "changes the body's velocity by (" in said
    assert roll(fitted, tmp_path / "no", "--body", "1", "--most", "2") == 2
    assert "say where to with --reach" in capsys.readouterr().err


def period(path, times):
    """Seconds between the times at which it swings through the middle to the right."""
    x = path[:, 0, 0] - 0.1
    through = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    return np.diff(times[through] - x[through] / np.diff(x)[through] * np.diff(times)[0]).mean()


def test_other_laws_are_what_they_are_called(fitted):
    model = load_fitted(fitted[0])
    motion = read_tracks(fitted[2]).motion
    start = model.last(motion)

    def path(**factors):
        other = model.under(factors)
        return other.roll(start, 0.0, 120, STEP, other.params)

    held = path()
    heavy = model.under({"mass": 3.0, "friction": 3.0})
    pushed = PhaseState(start.q, 3 * start.p)
    same = heavy.roll(pushed, 0.0, 120, STEP, heavy.params)  # three times each cancels
    assert np.abs(same.positions - held.positions).max() < 1e-4
    slow, fast = (period(x.positions, x.times) for x in (held, path(gravity=2.0)))
    assert fast == pytest.approx(slow / 2**0.5, rel=0.05)
    speed = [np.abs(np.diff(x.positions[-60:, 0, 0])).max() for x in (path(friction=0.0), held)]
    assert speed[0] > 1.2 * speed[1]
    assert model.under({"length": 0.5}).head.law.potential.rate2.item() == pytest.approx(
        2 * model.head.law.potential.rate2.item()
    )


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--law", "lenght=2"), "--law lenght: this model has no such number; it has friction"),
        (("--law", "restitution=0.5"), "it has friction, gravity, length, mass"),
        (("--law", "friction"), "write NAME=FACTOR"),
        (("--law", "length=0"), "--law length=0: no length at all means nothing"),
        (("--law", "friction=-1"), "must be zero or above"),
        (("--coupling", "2"), "--coupling: this model has no force between its bodies"),
        (("--head", "factored"), "--head: would have no effect"),
        (("--video", "film.mp4"), "--video: a table has no frames to draw over"),
        (("--beyond", "0"), "--beyond 0.0: must be above 0"),
        (("nowhere.csv",), "nowhere.csv: no such file"),
    ],
)
def test_what_cannot_be_asked_is_said_with_what_can(fitted, tmp_path, capsys, more, words):
    assert roll(fitted, tmp_path / "out", *more) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_heat_bath_is_learned_and_foretold_by_the_mean_of_its_paths(tmp_path):
    law = Parameters(torch.ones(1), torch.ones(1, 1)).with_scalar("temperature", 0.3)
    bath = terms.Hamiltonian(potentials=(terms.Trap(4.0),), ports=(terms.ConstantBath(0.8),))
    start = PhaseState(torch.zeros(1, 1, 2), torch.zeros(1, 1, 2))
    path = rollout(build(bath, 1, 0.02), start, law, 6000, 0.02, every=5, seed=3).states.q.numpy()
    write_tracks(tmp_path / "t.csv", motion_of(path[:, 100:].astype(float) + 5.0, 0.1))
    rough = bath.throughout(rate=2.0)
    numbers = {"bath: temperature": (1.0, float("nan"))}
    held = as_specification(rough, 1, [5.0, 5.0], numbers, True, 0.1)
    write_json(tmp_path / "s.json", held)
    told = ["--specification", str(tmp_path / "s.json"), "--out", str(tmp_path / "run"), "--quiet"]
    assert main(["fit", str(tmp_path / "t.csv"), *told, "--steps", "2"]) == 0
    rows = pq.read_table(tmp_path / "run" / "records.parquet").to_pylist()
    found = {row["metric"]: row["value"] for row in rows}
    assert found["friction_bath"] == pytest.approx(0.8, rel=0.5)
    assert found["temperature"] == pytest.approx(0.3, rel=0.4)
    more = ["--beyond", "10", "--law", "temperature=4", "friction=2", "--quiet"]
    assert main(["rollout", str(tmp_path / "run"), "--out", str(tmp_path / "r"), *more]) == 0
    rolled = np.load(tmp_path / "r" / "rollout.npz")
    assert rolled["spread"][0].max() < 1e-9
    assert rolled["spread"][-50:].mean() == pytest.approx((0.3 / 4) ** 0.5, rel=0.3)
    assert (
        json.loads((tmp_path / "run" / "run.json").read_text())["settings"]["experiment"] == "fit"
    )
