"""Recordings, figures and the report show what the records and arrays say, and nothing else."""

from __future__ import annotations

import base64
import errno
import io
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tyro
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from vidphys.cli.recordings import told_law
from vidphys.cli.view import ViewConfig, view
from vidphys.errors import InputError
from viz import figures, sentences, viewer
from viz.cells import number
from viz.overlay import BODY_COLOURS, contact_sheet, energy_range, world_to_pixel
from viz.recording import write_overlay_recording, write_recording
from viz.report import read_run, write_report
from viz.showcase import ROLES
from viz.story import marks, story
from viz.summary import Line, Records, one_sided_p, paired, summarise
from viz.tables import couplings_table, other_table, verdict_table

COUPLINGS = (-0.5, -1.0, -1.5)
HORIZONS = (100, 500, 1000, 2000)
STRINGS = ("experiment", "cell", "system", "grounding", "encoder", "binder", "readout", "head")
SCHEMA = pa.schema(
    [(name, pa.string()) for name in (*STRINGS, "metric", "status", "device", "dtype")]
    + [(name, pa.int64()) for name in ("seed", "horizon", "episodes", "nonfinite")]
    + [(name, pa.float64()) for name in ("coupling", "value", "seconds")]
)
LADDER = (
    ("oracle", "none", 3e-6),
    ("renderer", "differencing", 3e-3),
    ("renderer", "shooting", 4e-4),
    ("anonymous-tracker", "differencing", 0.2),
    ("anonymous-tracker", "shooting", 0.009),
)
HEADS = {"factored": 1.0, "unstructured": 1e4}
REFERENCES = {"oracle/factored": 0.067, "renderer/factored": 0.12}


def row(grounding, readout, head, seed, metric, value, *, coupling=None, horizon=None, **other):
    return {
        "experiment": "ladder",
        "cell": f"{grounding}/{head}",
        "system": "gravity",
        "grounding": grounding,
        "encoder": "none",
        "binder": "none",
        "readout": readout,
        "head": head,
        "seed": seed,
        "metric": metric,
        "coupling": coupling,
        "horizon": horizon,
        "value": value,
        "status": "ok",
        "episodes": 64,
        "nonfinite": 0,
        "seconds": 12.5,
        "device": "cpu",
        "dtype": "float32",
        **other,
    }


def cell_rows(grounding, readout, head, error, seed):
    """The numbers of one cell and seed; the error grows with the seed and with the coupling."""
    twin = head == "unstructured"
    rows = []

    def add(metric, value, **keys):
        rows.append(row(grounding, readout, head, seed, metric, value, **keys))

    for coupling in COUPLINGS:
        at = {"coupling": coupling, "horizon": 150}
        nmse = min(error * (1 + 0.2 * seed) * abs(coupling), 3.0)
        add("inversion_nmse", nmse, **at)
        add("ballistic_nmse", 0.11 * abs(coupling), **at)
        add("ballistic_skill", nmse / (0.11 * abs(coupling)), **at)
        add("regime_match", float(nmse < 0.3), **at)
        add("regime_match_gated", float(nmse < 0.11), **at)
        add("truth_distance", 0.4 * abs(coupling), **at)
        add("force_cosine", -0.1 if twin else 0.9995 - min(0.4, error), **at)
    add("in_distribution_nmse", error / 3, coupling=1.0, horizon=150)
    for horizon in HORIZONS:
        growth = horizon / 100 if twin else 1.0
        add("energy_drift_median", 1e-3 * growth**2 * (1 + seed), horizon=horizon)
        add("energy_drift_worst", 2e-2 * growth**2 * (1 + seed), horizon=horizon)
        add("energy_drift_over_one", 0.3 if twin else 0.0, horizon=horizon)
    if grounding != "oracle":
        add("position_nmse", 1e-4)
        add("momentum_nmse", 2e-3)
    return rows


def fail(rows, seed, metric, status="failed", nonfinite=3):
    """Take the number of one metric and seed away."""
    for entry in rows:
        if entry["seed"] == seed and entry["metric"] == metric:
            entry |= {"value": None, "status": status, "nonfinite": nonfinite}


def make_rows(seeds):
    rows = []
    for grounding, readout, error in LADDER:
        for head, factor in HEADS.items():
            part = [
                entry
                for seed in range(seeds)
                for entry in cell_rows(grounding, readout, head, error * factor, seed)
            ]
            if (grounding, readout, head) == ("renderer", "differencing", "unstructured"):
                fail(part, 0, "energy_drift_worst")
                fail(part, 0, "energy_drift_median")
            if (grounding, readout) == ("anonymous-tracker", "differencing"):
                for entry in part:
                    entry["status"] = "invalid"
            rows += part
    return rows


def make_run(path: Path, seeds: int = 3) -> Path:
    """A run folder as the ladder leaves it, with invented numbers."""
    path.mkdir(parents=True)
    rows = make_rows(seeds)
    pq.write_table(pa.Table.from_pylist(rows, SCHEMA), path / "records.parquet")
    run = {
        "experiment": "ladder",
        "preset": "quick",
        "settings": {
            "generator": "gaussian",
            "train": {"steps": 600, "lr": [1e-3, 3e-3]},
            "tables": {"ladder": {"references": REFERENCES}},
            "weights": "/home/somebody/project/weights/hiera",
        },
        "seeds": list(range(seeds)),
        "versions": {"python": "3.11", "torch": "2.15"},
        "device": "cpu",
        "dtype": "float32",
        "code_version": "abc1234",
        "schema_version": 1,
        "created": "2026-01-02T03:04:05+00:00",
        "skipped": [{"cell": "videomae/factored", "reason": "no weights: vidphys weights <fetch>"}],
    }
    (path / "run.json").write_text(json.dumps(run))
    return path


def gravity(q, p, coupling, steps, dt=0.002):
    """Three unit masses under softened gravity, leapfrog; positions and energies."""

    def pair(q):
        gap = q[:, None] - q[None]
        return gap, (gap**2).sum(-1) + 0.01

    def force(q):
        gap, square = pair(q)
        return -(coupling * gap / square[..., None] ** 1.5).sum(1)

    def energy(q, p):
        upper = np.triu_indices(3, 1)
        return (p**2).sum() / 2 - (coupling / np.sqrt(pair(q)[1]))[upper].sum()

    path, energies = [q], [energy(q, p)]
    for _ in range(steps):
        p = p + dt / 2 * force(q)
        q = q + dt * p
        p = p + dt / 2 * force(q)
        path.append(q)
        energies.append(energy(q, p))
    return np.array(path), np.array(energies), p


def make_showcase(pictures=True):
    """One episode: 15 frames of context under the law that held, then 150 steps."""
    start = np.array([[-1.3, 0.4], [1.2, 0.3], [0.1, -1.3]])
    push = np.array([[0.2, -0.5], [-0.2, 0.6], [0.3, -0.1]])
    before, energy, p = gravity(start, push, 1.0, 600)
    q = before[-1]
    runs = {
        "truth": gravity(q, p, 1.0, 150),
        "prediction": gravity(q + 0.01, p * 1.1, 1.0, 150),
        "counterfactual_truth": gravity(q, p, -1.0, 150),
        "counterfactual": gravity(q + 0.01, p * 1.1, -1.0, 150),
    }
    arrays = {"times": np.r_[-600:0:10, 0:151] * 0.002, "half_extent": np.array(4.0)}
    for role, (path, energies, _) in runs.items():
        past = before[:-1:10] if role == "truth" else np.full((60, 3, 2), np.nan)
        past_energy = energy[:-1:10] if role == "truth" else np.full(60, np.nan)
        arrays[role] = np.concatenate([past, path])
        arrays[f"energy_{role}"] = np.concatenate([past_energy, energies])
    long = gravity(q + 0.01, p * 1.1, 1.0, 1000)
    arrays |= {"long_times": np.arange(0, 1001, 20) * 0.002, "energy_long": long[1][::20]}
    if pictures:
        v, u = np.mgrid[:64, :64] + 0.5
        seen = before[::40]
        frames = np.zeros((16, 64, 64, 3))
        for n, colour in enumerate([(230, 80, 60), (70, 200, 90), (80, 120, 240)]):
            x, y = (u - 32) / 8, (32 - v) / 8
            square = (x - seen[:, None, None, n, 0]) ** 2 + (y - seen[:, None, None, n, 1]) ** 2
            frames += np.exp(-square / 0.1)[..., None] * np.array(colour)
        arrays |= {
            "frames": frames.clip(0, 255).astype(np.uint8),
            "frame_times": np.arange(-15, 1) * 0.08,
            "track": seen,
        }
    return arrays


def make_video():
    """A clip of one body, a readout that is off by a little, a rollout past the end."""
    times, ahead = np.arange(30) / 30, np.arange(20, 45) / 30

    def place(t):
        return np.stack([0.5 * np.sin(4 * t), -0.3 - 0.1 * np.cos(8 * t)], -1)[:, None]

    return {
        "frames": np.full((30, 640, 360, 3), 120, np.uint8),
        "frame_times": times,
        "track": place(times),
        "readout": place(times) + 0.01,
        "rollout": place(ahead) * 1.02,
        "rollout_times": ahead,
        "half_extent": np.array(2.0),
        "train_end": np.array(0.6),
    }


def read_back(path):
    """Every entity of a recording: its instants (seconds) and its columns, in time order."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(str(path)).store().stream().to_chunks():
        entity = found.setdefault(str(chunk.entity_path), {})
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if not name.startswith("rerun.controls"):
                whole = column.cast(pa.int64()) if pa.types.is_duration(column.type) else column
                entity.setdefault(name, []).extend(whole.to_pylist())
    return found


def seconds(entity):
    return np.array(entity["sim_time"]) / 1e9


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("rrd") / "deep" / "cell.rrd"
    write_recording(make_showcase(), {"cell": "oracle/factored", "seed": "0"}, path)
    return read_back(path), path


class TestRecording:
    def test_siblings_stand_on_one_timeline_with_what_was_given(self, recording):
        entities, _ = recording
        showcase = make_showcase()
        times = showcase["times"]
        for role in ROLES:
            points = entities[f"/world/{role}"]
            assert np.allclose(seconds(points), times, atol=1e-9)
            for k in (0, 59, 60, 100, 210):
                wanted = showcase[role][k]
                wanted = wanted if np.isfinite(wanted).all() else np.zeros((0, 2))
                stored = np.array(points["Points2D:positions"][k]).reshape(-1, 2)
                assert np.allclose(stored, wanted, atol=1e-6), (role, k)
            energy = entities[f"/energy/{role}"]
            kept = np.isfinite(showcase[f"energy_{role}"])
            assert np.allclose(seconds(energy), times[kept], atol=1e-9)
            stored = np.array(energy["Scalars:scalars"]).ravel()
            assert np.array_equal(stored, showcase[f"energy_{role}"][kept])

    def test_steps_count_from_the_moment_when_the_law_may_change(self, recording):
        points = recording[0]["/world/truth"]
        assert points["step"][:2] == [-600, -590]
        assert points["step"][60] == 0 and points["step"][-1] == 150

    def test_energy_error_is_relative_to_the_first_rolled_instant(self, recording):
        energy = make_showcase()["energy_prediction"][60:]
        error = recording[0]["/energy_error/prediction"]
        wanted = np.abs(energy - energy[0]) / abs(energy[0])
        kept = wanted > 0
        assert np.allclose(seconds(error), (np.arange(151) * 0.002)[kept], atol=1e-9)
        assert np.allclose(np.array(error["Scalars:scalars"]).ravel(), np.log10(wanted[kept]))

    def test_the_past_is_cleared_when_the_rollout_begins(self, recording):
        context = recording[0]["/world/context"]
        counts = [len(row or []) for row in context["Points2D:positions"]]
        assert counts[:61] == [3] * 61 and set(counts[61:]) == {0}

    def test_trails_hold_each_piece_of_the_path_once(self, recording):
        trail = recording[0]["/world/prediction/trail"]
        path = make_showcase()["prediction"][60:]
        assert len(trail["sim_time"]) == 150
        stored = np.array(trail["LineStrips2D:strips"][7])
        assert np.allclose(stored[2], path[7:9, 2], atol=1e-6)

    def test_pictures_lie_under_the_track_in_pixels(self, recording):
        entities, _ = recording
        showcase = make_showcase()
        images = entities["/camera/image"]
        assert np.allclose(seconds(images), showcase["frame_times"], atol=1e-9)
        stored = np.array(images["Image:buffer"][3], np.uint8).reshape(64, 64, 3)
        assert np.array_equal(stored, showcase["frames"][3])
        track = np.array(entities["/camera/track"]["Points2D:positions"][3])
        row, column = np.unravel_index(stored[..., 0].argmax(), (64, 64))
        assert abs(track[0, 0] - (column + 0.5)) < 1 and abs(track[0, 1] - (row + 0.5)) < 1

    def test_the_layout_travels_in_the_file(self, recording):
        from rerun.chunk import RrdReader

        reader = RrdReader(str(recording[1]))
        (layout,) = reader.blueprints()
        names = set()
        for chunk in reader.store(store=layout).stream().to_chunks():
            batch = chunk.to_record_batch()
            if "ViewBlueprint:display_name" in batch.schema.names:
                names |= {row[0] for row in batch["ViewBlueprint:display_name"].to_pylist()}
        wanted = {"The trained law", "What if the coupling flips", "Energy, the long rollout"}
        assert wanted <= names
        assert not list(recording[1].parent.glob("*partial*"))

    def test_a_diverged_rollout_is_blank_from_there_on(self, tmp_path):
        showcase = make_showcase(pictures=False)
        showcase["counterfactual"][150:] = np.inf
        showcase["energy_counterfactual"][150:] = np.nan
        write_recording(showcase, {"cell": "x"}, tmp_path / "x.rrd")
        entities = read_back(tmp_path / "x.rrd")
        points = entities["/world/counterfactual"]["Points2D:positions"]
        assert len(points[149]) == 3 and all(not row for row in points[150:])
        assert len(entities["/energy/counterfactual"]["sim_time"]) == 90
        assert "/camera/image" not in entities

    def test_what_was_perceived_is_the_past_where_the_truth_begins_at_zero(self, tmp_path):
        showcase = make_showcase()
        for key in ("times", *ROLES, *(f"energy_{role}" for role in ROLES)):
            showcase[key] = showcase[key][60::10]
        showcase["dt"] = np.array([0.002])
        write_recording(showcase, {"cell": "x"}, tmp_path / "x.rrd")
        entities = read_back(tmp_path / "x.rrd")
        context = entities["/world/context"]
        assert np.allclose(seconds(context)[:16], showcase["frame_times"], atol=1e-9)
        assert np.allclose(context["Points2D:positions"][2], showcase["track"][2], atol=1e-6)
        assert len(context["step"]) == 17 and not context["Points2D:positions"][-1]
        assert entities["/world/truth"]["step"] == list(range(0, 151, 10))
        assert context["step"][0] == -600 and entities["/phase"]["step"][0] == -600

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda s: s.pop("counterfactual"), "missing counterfactual"),
            (lambda s: s.update(truth=s["truth"][:-1]), r"truth must have shape|must have shape"),
            (lambda s: s.update(times=s["times"][::-1]), "increasing"),
            (lambda s: s.update(frames=s["frames"] / 255), "uint8"),
            (lambda s: s.update(track=s["track"][1:]), "do not belong together"),
            (lambda s: s.update(half_extent=np.zeros(3)), "half_extent"),
            (lambda s: s.pop("long_times"), "missing long_times"),
        ],
    )
    def test_bad_arrays_are_refused_and_leave_nothing(self, tmp_path, change, message):
        showcase = make_showcase()
        change(showcase)
        with pytest.raises(ValueError, match=message):
            write_recording(showcase, {"cell": "x"}, tmp_path / "x.rrd")
        assert not list(tmp_path.iterdir())

    def test_attention_lies_over_the_clip_in_the_colours_of_the_bodies_and_ends_with_it(
        self, tmp_path
    ):
        video = make_video()
        shares = np.full((30, 1, 8, 4), 0.01, np.float32)
        shares[:, 0, 6, 1] = 0.64
        video |= {"attention": shares, "attention_times": video["frame_times"]}
        write_overlay_recording(video, {"cell": "x"}, tmp_path / "v.rrd")
        found = read_back(tmp_path / "v.rrd")["/video/attention"]
        veil = np.frombuffer(bytes(found["Image:buffer"][4][0]), np.uint8).reshape(8, 4, 4)
        assert tuple(veil[6, 1]) == (*BODY_COLOURS[0], 160) and veil[0, 0, 3] == 2
        scale = np.array(found["Transform3D:mat3x3"][0]).ravel()
        assert scale[0] == 360 / 4 and scale[4] == 640 / 8  # to the picture's pixels
        assert found["Clear:is_recursive"] and max(found["sim_time"]) == 10**9

    def test_attention_of_a_rung_lies_over_its_context_and_ends_with_it(self, tmp_path):
        showcase = make_showcase() | {"attention": np.full((16, 3, 4, 4), 1 / 16, np.float32)}
        write_recording(showcase, {"cell": "x"}, tmp_path / "x.rrd")
        found = read_back(tmp_path / "x.rrd")["/camera/attention"]
        assert len(found["Image:buffer"]) == 16
        assert found["Clear:is_recursive"] and max(seconds(found)) == pytest.approx(0.002)
        with pytest.raises(ValueError, match="attention must have shape"):
            showcase["attention"] = showcase["attention"][:, :2]
            write_recording(showcase, {"cell": "x"}, tmp_path / "y.rrd")

    def test_a_real_clip_is_drawn_over_and_ends_before_the_rollout(self, tmp_path):
        video = make_video()
        write_overlay_recording(video, {"cell": "pendulum"}, tmp_path / "v.rrd")
        entities = read_back(tmp_path / "v.rrd")
        images = entities["/video/image"]
        assert set(images["EncodedImage:media_type"][0]) == {"image/jpeg"}
        assert len(images["sim_time"]) == 31  # and the dimmed one after the end
        x, y = video["rollout"][4, 0]
        stored = np.array(entities["/video/rollout"]["Points2D:positions"][4])[0]
        assert np.allclose(stored, [180 + x * 160, 320 - y * 160], atol=1e-3)
        observed = entities["/video/observed"]["Points2D:positions"]
        assert len(observed) == 31 and not observed[-1]
        rolled = entities["/position_y/rollout"]
        assert np.array_equal(np.array(rolled["Scalars:scalars"])[:, 0], video["rollout"][:, 0, 1])
        assert seconds(rolled)[-1] > seconds(images)[-1]
        states = [row[0] for row in entities["/phase"]["StateChange:state"]]
        assert states == ["trained on", "held out", "past the end of the clip"]


def test_small_pictures_are_stored_as_they_are(tmp_path):
    video = make_video()
    rng = np.random.default_rng(0)
    video["frames"] = rng.integers(0, 256, (30, 96, 64, 3)).astype(np.uint8)
    write_overlay_recording(video, {"cell": "small"}, tmp_path / "v.rrd")
    images = read_back(tmp_path / "v.rrd")["/video/image"]
    assert "EncodedImage:media_type" not in images
    stored = np.array(images["Image:buffer"][7], np.uint8).reshape(96, 64, 3)
    assert np.array_equal(stored, video["frames"][7])


def test_a_small_drift_is_drawn_on_a_wide_axis():
    low, high = energy_range(-2.0, -1.9986)
    assert low < -2.15 and high > -1.85
    assert energy_range(-2.0, 1.0) == (-2.0, 1.0)
    showcase = make_showcase()
    flat = 5.0 + 1e-3 * np.linspace(0, 1, len(showcase["times"]))
    for role in ROLES:
        showcase[f"energy_{role}"] = flat
    sheet = contact_sheet(showcase, {})
    panel = next(a for part in sheet.subfigs for a in part.axes if a.get_title() == "Energy")
    low, high = panel.get_ylim()
    assert high - low >= 0.19 * 5


def test_a_head_scored_as_it_was_trained_is_no_cell_of_its_own():
    rows = make_rows(1)
    joint = [{**row, "grounding": "oracle-joint"} for row in rows if row["grounding"] == "oracle"]
    planned = {(row["grounding"], row["head"]) for row in rows} | {("hiera", "factored")}
    about = {"settings": {"asked": {f"ladder/{rung}/{head}": [0] for rung, head in planned}}}
    told = sentences.asked(Records(rows + joint), about)
    rungs = len({rung for rung, _ in planned}) - 1
    assert f"{len(planned) - 1} of {len(planned)} cells on {rungs} rungs" in told


def test_beside_a_recording_stands_what_was_asked_and_how_it_went(tmp_path):
    run = make_run(tmp_path / "run", 3)
    told = story(run, {"cell": "oracle/factored", "seed": "0", "coupling": "0.78"})
    records = Records(make_rows(3))
    line = Line("oracle", "none", "factored")
    error = records.pick(line, "inversion_nmse", coupling=records.coupling)
    assert told["trained on"] == "G > 0 only" and "G = 0.78" in told["asked"]
    assert told["error under G = −1 (nMSE)"] == number(error.mean)
    assert told["verdict"].startswith("holds") and "without any force" in told["skill"]
    assert story(tmp_path, {"cell": "x"}) == {"cell": "x"}
    write_recording(make_showcase(), told, tmp_path / "x.rrd")
    about = str(read_back(tmp_path / "x.rrd")["/about"])
    assert "holds" in about and "recording://world/counterfactual" in about


def test_what_happens_to_bodies_is_marked():
    showcase = make_showcase()
    times = showcase["times"]
    first = int(np.flatnonzero(times > 0)[0])
    for role in ("truth", "prediction", "counterfactual"):
        showcase[role] = np.zeros_like(showcase[role])
        showcase[role][:, 1], showcase[role][:, 2] = [3.0, 0.0], [0.0, 3.0]
    showcase["truth"][first + 20, 1] = [0.5, 0.0]
    showcase["counterfactual"][first + 30 :, 0] = np.nan
    found = marks(showcase)
    assert found[times[first + 20]] == "closest approach, 0.5"
    assert found[times[first + 21]] == "rolled out"
    assert found[times[first + 30]] == "the model, flipped is not finite"
    assert len(found) == 3


def test_laws_are_called_by_their_words(tmp_path):
    write_recording(make_showcase(), {"cell": "x", "coupling": "0.78"}, tmp_path / "x.rrd")
    entities = read_back(tmp_path / "x.rrd")
    names = {role: str(entities[f"/energy/{role}"]["SeriesLines:names"]) for role in ROLES}
    assert "G = 0.78, model" in names["prediction"] and "G = −1, model" in names["counterfactual"]
    video = make_video()
    video |= {"changed": video["rollout"], "changed_times": video["rollout_times"]}
    write_overlay_recording(video, {"cell": "x", "law": "friction times 0"}, tmp_path / "v.rrd")
    changed = read_back(tmp_path / "v.rrd")["/position_x/changed"]
    assert "friction times 0" in str(changed["SeriesLines:names"])
    assert told_law(-1.0, ("friction=0",)) == "G = −1, friction times 0"


def test_large_pictures_are_shrunk_and_long_clips_thinned(tmp_path):
    video = make_video()
    count = 801
    video["frames"] = np.zeros((count, 8, 1300, 3), np.uint8)
    video["frame_times"] = np.arange(count) / 30
    video["track"] = video["readout"] = np.zeros((count, 1, 2))
    write_overlay_recording(video, {"cell": "long"}, tmp_path / "v.rrd")
    entities = read_back(tmp_path / "v.rrd")
    assert len(entities["/video/image"]["sim_time"]) <= 401
    assert len(entities["/video/observed"]["sim_time"]) == count + 1
    centre = np.array(entities["/video/observed"]["Points2D:positions"][0])[0]
    assert np.allclose(centre, [1300 / 3 / 2, 8 / 3 / 2], atol=1e-3)
    assert (tmp_path / "v.rrd").stat().st_size < 2_000_000


@given(
    st.tuples(st.integers(4, 300), st.integers(4, 300)),
    st.floats(0.1, 50),
    st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
)
def test_world_to_pixel_is_the_image_convention(size, extent, place):
    height, width = size
    u, v = world_to_pixel(np.array(place) * extent, size, extent)
    assert math.isclose(u, width / 2 + place[0] * max(size) / 2, abs_tol=1e-6)
    assert math.isclose(v, height / 2 - place[1] * max(size) / 2, abs_tol=1e-6)


class TestSummary:
    @pytest.mark.parametrize("seeds", [1, 3, 4, 5, 10])
    def test_interval_from_five_seeds_else_range(self, seeds):
        values = np.random.default_rng(seeds).lognormal(size=seeds)
        rows = [
            row("oracle", "none", "factored", s, "force_cosine", v) for s, v in enumerate(values)
        ]
        found = summarise(rows)
        assert math.isclose(found.mean, values.mean())
        if seeds == 1:
            assert found.interval is None
        elif seeds < 5:
            assert found.interval == (values.min(), values.max(), "range")
        else:
            half = 1.96 * values.std(ddof=1) / math.sqrt(seeds)
            low, high, kind = found.interval
            assert kind == "95 %"
            assert math.isclose(low, values.mean() - half)
            assert math.isclose(high, values.mean() + half)

    def test_an_error_has_no_negative_interval_but_a_cosine_has(self):
        values = [0.0, 0.0, 0.0, 0.0, 5.0]

        def lower(metric):
            rows = [row("oracle", "none", "factored", s, metric, v) for s, v in enumerate(values)]
            return summarise(rows).interval[0]

        assert lower("inversion_nmse") == 0 and lower("force_cosine") < 0

    @pytest.mark.parametrize("status", ["failed", "invalid", "void", "skipped"])
    def test_only_ok_counts(self, status):
        rows = [row("oracle", "none", "factored", s, "inversion_nmse", 1.0 + s) for s in range(3)]
        rows[1] |= {"status": status, "value": 99.0 if status == "invalid" else None}
        found = summarise(rows)
        assert found.values == (1.0, 3.0) and found.seeds == (0, 2)
        assert found.words == f"{status} 1/3"

    def test_an_ok_record_without_a_number_does_not_vanish(self):
        rows = [row("oracle", "none", "factored", 0, "inversion_nmse", float("nan"))]
        assert summarise(rows).mean is None and summarise(rows).words == "no value 1/1"

    def test_pairs_share_a_seed(self):
        mine = summarise([row("a", "none", "factored", s, "inversion_nmse", s) for s in (1, 2, 3)])
        its = summarise([row("a", "none", "x", s, "inversion_nmse", 10 * s) for s in (3, 1)])
        assert paired(mine, its) == [(1, 10), (3, 30)]

    @pytest.mark.parametrize(
        ("hits", "total", "ways"), [(10, 10, 1), (8, 10, 56), (2, 3, 4), (0, 4, 16), (3, 3, 1)]
    )
    def test_exact_binomial(self, hits, total, ways):
        assert one_sided_p(hits, total) == ways / 2**total

    def test_the_headline_is_minus_one_and_two_thousand_steps(self):
        rows = make_rows(1)
        rows += [row("oracle", "none", "factored", 0, "energy_drift_median", 1.0, horizon=10_000)]
        records = Records(rows)
        assert records.coupling == -1.0 and records.horizon == 2000
        assert records.horizons[-1] == 10_000
        assert [line.head for line in records.rungs["oracle"]] == ["factored", "unstructured"]
        assert next(iter(records.rungs)) == "oracle"

    def test_missing_columns_and_no_rows_are_refused(self):
        with pytest.raises(ValueError, match="at least one row"):
            Records([])
        with pytest.raises(ValueError, match="coupling"):
            Records([{k: v for k, v in make_rows(1)[0].items() if k != "coupling"}])


class Tables(HTMLParser):
    """Every table of a page: rows of (text, attributes), rungs carried into the rows below."""

    def __init__(self, page):
        super().__init__()
        self.tables, self.cell, self.texts = [], None, []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.cell = [[], dict(attributes)]
            self.tables[-1][-1].append(self.cell)

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self.cell = None

    def handle_data(self, data):
        if self.cell is not None:
            self.cell[0].append(data)

    def row(self, table, rung, head):
        """The cells after the head's name."""
        now = None
        for cells in self.tables[table]:
            if cells and cells[0][1].get("scope") == "rowgroup":
                now = " · ".join(cells[0][0])
                cells = cells[1:]
            if now == rung and cells and cells[0][0] == [head]:
                return [(" ".join(text), attributes) for text, attributes in cells[1:]]
        raise AssertionError(f"no row {rung}, {head}")


FIRST, VERDICT, LADDER_TABLE = 0, 1, 2
SHOWN = 5e-6  # of a number, that its digits in a page leave open
STATUS, ERROR, MATCH, SKILL, COSINE, DRIFT, WORST, NONFINITE = range(8)
HEADLINES = {ERROR: "inversion_nmse", SKILL: "ballistic_skill", COSINE: "force_cosine"}


def values_of(rows, rung, head, metric, **keys):
    """Straight from the rows, without the code under test."""
    grounding, _, readout = rung.partition(" · ")
    wanted = {"grounding": grounding, "readout": readout or "none", "head": head, "metric": metric}
    found = [r for r in rows if all(r[k] == v for k, v in {**wanted, **keys}.items())]
    return [r["value"] for r in found if r["status"] == "ok" and r["value"] is not None]


@pytest.fixture(scope="module", params=[1, pytest.param(3, marks=pytest.mark.slow), 10])
def reported(request, tmp_path_factory):
    run = make_run(tmp_path_factory.mktemp("run") / f"seeds-{request.param}", request.param)
    path = write_report(run)
    rows = pq.read_table(run / "records.parquet").to_pylist()
    return run, path.read_text(encoding="utf-8"), rows, request.param


class TestReport:
    def test_numbers_are_those_of_the_records(self, reported):
        _, page, rows, _ = reported
        tables = Tables(page)
        for rung in ("oracle", "renderer · shooting", "anonymous-tracker · shooting"):
            for head in HEADS:
                cells = tables.row(LADDER_TABLE, rung, head)
                at = {"coupling": -1.0}
                for k, metric in HEADLINES.items():
                    exact = float(cells[k][1]["data-value"])
                    mean = np.mean(values_of(rows, rung, head, metric, **at))
                    assert math.isclose(exact, mean, rel_tol=SHOWN)
                    shown = float(cells[k][0].split()[0])
                    assert math.isclose(shown, exact, rel_tol=5.1e-3)
                long = {"horizon": 2000}
                middle = np.median(values_of(rows, rung, head, "energy_drift_median", **long))
                worst = max(values_of(rows, rung, head, "energy_drift_worst", **long))
                assert math.isclose(float(cells[DRIFT][1]["data-value"]), middle, rel_tol=SHOWN)
                assert math.isclose(float(cells[WORST][1]["data-value"]), worst, rel_tol=SHOWN)

    def test_the_spread_is_named_for_what_it_is(self, reported):
        _, page, rows, seeds = reported
        text = Tables(page).row(LADDER_TABLE, "renderer · shooting", "factored")[ERROR][0]
        values = np.array(
            values_of(rows, "renderer · shooting", "factored", "inversion_nmse", coupling=-1.0)
        )
        if seeds == 1:
            assert "range" not in text and "[" not in text
        elif seeds == 3:
            low, high = text.split("range ")[1].split(" to ")
            assert np.allclose([float(low), float(high)], [values.min(), values.max()], rtol=5e-3)
        else:
            low, high = text[text.index("[") + 1 : text.index("]")].split(",")
            half = 1.96 * values.std(ddof=1) / math.sqrt(seeds)
            wanted = [values.mean() - half, values.mean() + half]
            assert np.allclose([float(low), float(high)], wanted, rtol=5e-3)
            assert "normal approximation" in page

    def test_all_matching_seeds_carry_the_exact_test(self, reported):
        _, page, _, seeds = reported
        text = Tables(page).row(LADDER_TABLE, "oracle", "factored")[MATCH][0]
        assert text.startswith(f"{seeds}/{seeds} p = ")
        assert math.isclose(float(text.split("p = ")[1].split()[0]), 0.5**seeds, rel_tol=5e-3)
        twin = Tables(page).row(LADDER_TABLE, "renderer · shooting", "unstructured")[MATCH][0]
        assert twin.startswith(f"0/{seeds}") and "p =" not in twin

    def test_skill_is_marked_by_seed(self, reported):
        _, page, _, seeds = reported
        tables = Tables(page)
        good = tables.row(LADDER_TABLE, "oracle", "factored")[SKILL][0]
        bad = tables.row(LADDER_TABLE, "renderer · shooting", "unstructured")[SKILL][0]
        assert f"< 0.5 on {seeds}/{seeds}" in good and f"< 0.5 on 0/{seeds}" in bad

    def test_failed_and_invalid_cells_are_words(self, reported):
        _, page, rows, seeds = reported
        tables = Tables(page)
        invalid = tables.row(LADDER_TABLE, "anonymous-tracker · differencing", "factored")
        assert all(f"invalid {seeds}/{seeds}" in invalid[k][0] for k in range(WORST + 1))
        assert not any("data-value" in invalid[k][1] for k in range(WORST + 1))
        failed = tables.row(LADDER_TABLE, "renderer · differencing", "unstructured")
        assert f"failed 1/{seeds}" in failed[DRIFT][0]
        assert failed[NONFINITE][0] == f"3/{64 * seeds}"
        left = values_of(
            rows, "renderer · differencing", "unstructured", "energy_drift_median", horizon=2000
        )
        assert ("data-value" in failed[DRIFT][1]) == bool(left)
        assert f"failed 1/{seeds}" in failed[STATUS][0]

    def test_trouble_is_told_with_its_reason(self, reported):
        page = reported[1]
        part = page[page.index('id="troubles"') : page.index('id="verdicts"')]
        assert "videomae/factored" in part and "no weights: vidphys weights &lt;fetch&gt;" in part
        assert "every metric (every seed)" in part and "energy_drift_worst (" in part
        assert "no verdict" in part

    def test_the_verdict_pairs_each_head_with_its_twin(self, reported):
        _, page, rows, seeds = reported
        cells = Tables(page).row(VERDICT, "renderer · shooting", "factored")
        pair = [
            values_of(rows, "renderer · shooting", head, "inversion_nmse", coupling=-1.0)
            for head in HEADS
        ]
        ratio = np.mean(pair[1]) / np.mean(pair[0])
        assert math.isclose(float(cells[2][1]["data-value"]), ratio, rel_tol=SHOWN)
        assert cells[3][0] == f"{seeds}/{seeds} seeds" and cells[4][0].startswith("holds")

    def test_one_file_that_needs_nothing_else(self, reported):
        run, page, _, _ = reported
        assert "http:" not in page and "https:" not in page and "<script src" not in page
        assert not re.search(r'(src|href)="(?!#|data:)', page)
        assert not re.search(r">(nan|None|inf)<", page)
        assert len(page) < 1_500_000
        assert page.count("<svg") == 4
        for name in ("ladder", "force_cosine", "drift"):
            assert (run / "figures" / f"{name}.svg").is_file()
            assert (run / "figures" / f"{name}.png").read_bytes().startswith(b"\x89PNG")

    def test_the_first_screen_says_what_was_asked_what_holds_and_what_does_not(self, reported):
        page = reported[1]
        first = page[: page.index("</figure>")]
        for words in (
            "under G = −1",
            "of 5 rows of factored heads answer",
            "anonymous-tracker · diff",
        ):
            assert words in re.sub(r"\s+", " ", first)
        assert "not run: videomae" in first.replace("Not run", "not run")

    def test_the_study_stands_in_the_figures_and_in_the_first_table(self, reported):
        page = reported[1]
        first = page[page.index('<svg class="headline"') : page.index("</svg>")]
        for name, value in (("oracle", "0.067"), ("renderer", "0.12")):
            assert f"<title>{name}, the study: {value}</title>" in first
        beside = re.findall(r"<title>(renderer[^<]*)</title>\s*<circle class=.beside.", first)
        assert len(beside) == 1 and beside[0].startswith("renderer · differencing, factored")
        told = re.search(r'id="cells">(.*?)</table>', page, re.S)[1]
        shown = re.findall(r'data-value="(0\.067|0\.12)"', told)
        assert shown == ["0.067", "0.12"]  # not beside shooting, which the study does not have

    def test_each_row_says_how_to_repeat_it(self, reported):
        page, seeds = reported[1], reported[3]
        assert (
            f"vidphys ladder --preset quick --cells renderer/factored --seed 0 --seeds {seeds} "
            "--out runs/again" in page
        )

    def test_folders_of_the_machine_are_shortened(self, reported):
        page = reported[1]
        assert "/home/somebody" not in page and "…/weights/hiera" in page

    def test_what_was_run_is_all_there(self, reported):
        page = reported[1]
        for text in ("quick", "gaussian", "abc1234", "float32", "train.lr", "version of torch"):
            assert text in page


def test_a_worse_head_than_its_twin_does_not_hold():
    rows = make_rows(3)
    for entry in rows:
        if entry["cell"] == "oracle/unstructured" and entry["seed"] == 1:
            entry["value"] = 1e-9 if entry["metric"] == "inversion_nmse" else entry["value"]
        if entry["cell"] == "renderer/factored" and entry["readout"] == "shooting":
            entry["value"] = 0.7 if entry["metric"] == "ballistic_skill" else entry["value"]
        if entry["cell"] == "anonymous-tracker/unstructured":
            entry["status"] = "skipped"
    records = Records(rows)
    said = {
        row.line.rung: f"{row.cells[-1].marks[0][0]} {row.cells[-1].text}"
        for row in verdict_table(records).rows
    }
    assert list(said) == list(records.rungs)
    assert said["oracle"].startswith("does not hold") and "2/3 seeds only" in said["oracle"]
    assert said["renderer · differencing"].startswith("holds inverts; the twin is worse")
    assert said["renderer · shooting"] == "does not hold does not invert: skill up to 0.7"
    assert said["anonymous-tracker · differencing"].startswith("no verdict invalid 3/3")
    assert said["anonymous-tracker · shooting"] == "holds inverts; its twin: skipped 3/3"


def test_a_gate_that_was_not_passed_is_no_failure():
    rows = make_rows(2)
    for entry in rows:
        if entry["cell"] == "oracle/unstructured" and entry["metric"] == "regime_match_gated":
            entry |= {"value": None, "status": "invalid"}
    records = Records(rows)
    twin = next(x for x in records.rungs["oracle"] if x.head == "unstructured")
    assert records.troubles(twin) == {}
    found = records.pick(twin, "regime_match_gated", coupling=-1.0)
    assert found.words == "gate not passed 2/2"
    lost = next(x for x in records.lines if x.grounding == "anonymous-tracker")
    assert "regime_match_gated" in records.troubles(lost)["invalid"]


def test_episodes_and_other_metrics_are_shown(tmp_path):
    run = make_run(tmp_path / "run", 1)
    rows = [*make_rows(1), row("oracle", "none", "factored", 0, "temperature_error", 0.125)]
    pq.write_table(pa.Table.from_pylist(rows, SCHEMA), run / "records.parquet")
    raw = [
        row("oracle", "none", "factored", 0, "inversion_nmse", v, coupling=-1.0, episode=k)
        for k, v in enumerate([1e-3, 4e-3, 9.0])
    ]
    pq.write_table(pa.Table.from_pylist(raw), run / "episodes.parquet")
    _, records, episodes = read_run(run)
    cells = couplings_table(records, episodes).rows[0].cells
    assert [cell.text for cell in cells].count("0.004") == 1
    assert other_table(records).rows[0].cells[0].value == 0.125


def test_a_page_stays_small_however_many_episodes_there_are(tmp_path, monkeypatch):
    from safetensors.numpy import save_file

    run = make_run(tmp_path / "run", 1)
    (run / "showcase").mkdir()
    arrays = {k: np.ascontiguousarray(v) for k, v in make_showcase(pictures=False).items()}
    for head in HEADS:
        save_file(arrays, run / "showcase" / f"oracle-{head}.safetensors", {"seed": "0"})
    monkeypatch.setattr("viz.sections.SHEET_BYTES", 1)
    page = write_report(run).read_text(encoding="utf-8")
    assert page.count("data:image/png") == 1 and "1 more lie in figures/" in page
    assert (run / "figures" / "showcase-oracle-unstructured.png").is_file()


def test_another_experiment_has_no_ladder(tmp_path):
    run = make_run(tmp_path / "run", 1)
    rows = [row("hiera", "none", "factored", 0, "rollout_error", 0.03, horizon=90)]
    pq.write_table(pa.Table.from_pylist(rows, SCHEMA), run / "records.parquet")
    page = write_report(run).read_text(encoding="utf-8")
    assert 'id="ladder"' not in page and "does not hold" not in page
    assert 'data-value="0.03"' in page


def test_a_report_needs_its_files(tmp_path):
    with pytest.raises(ValueError, match="run.json is missing"):
        write_report(tmp_path / "nothing")
    run = make_run(tmp_path / "run", 1)
    (run / "records.parquet").write_bytes(b"not parquet")
    with pytest.raises(ValueError, match="cannot be read"):
        write_report(run)
    (run / "records.parquet").unlink()
    with pytest.raises(ValueError, match=r"records.parquet is missing"):
        write_report(run)
    assert not (run / "report.html").exists()


class TestFigures:
    def test_the_ladder_shows_means_seeds_references_and_failures(self):
        rows = make_rows(3)
        records = Records(rows)
        (axes,) = figures.ladder_figure(records, {"renderer/factored": 0.12}).axes
        lines = {}
        for drawn in axes.lines:
            lines.setdefault(drawn.get_marker(), []).append(np.atleast_1d(drawn.get_xdata()))
        seeds, mean = lines["o"][:2]
        wanted = values_of(rows, "oracle", "factored", "inversion_nmse", coupling=-1.0)
        assert np.allclose(seeds, wanted) and np.allclose(mean, np.mean(wanted))
        assert lines["*"] == [np.array([0.12])]  # differencing only: the study has no shooting
        assert "factored: invalid 3/3" in [text.get_text() for text in axes.texts]
        ballistic = [x for x in lines[""] if len(x) == 2]
        assert np.allclose(ballistic[0], 0.11)

    def test_drift_is_median_line_and_worst_band_capped_for_display(self):
        rows = make_rows(3)
        for entry in rows:
            if entry["cell"] == "oracle/unstructured" and entry["metric"] == "energy_drift_worst":
                entry["value"] *= 1e9
        figure = figures.drift_figure(Records(rows))
        axes = figure.axes[0]
        line = next(x for x in axes.lines if x.get_label() == "factored")
        assert list(line.get_xdata()) == list(HORIZONS)
        assert np.allclose(line.get_ydata(), 2e-3)
        tops = [c.get_paths()[0].vertices[:, 1].max() for c in axes.collections]
        assert np.isclose(tops[0], 0.06) and tops[1] == figures.DRIFT_CAP

    def test_heads_keep_their_looks_and_differ(self):
        heads = [*figures.STYLES, "gns", "composed"]
        looks = [figures.style(head, heads) for head in heads]
        assert len({marker for _, marker in looks}) == len(heads) == len({c for c, _ in looks})

    def test_contact_sheet_draws_both_laws(self, tmp_path):
        showcase = make_showcase()
        figure = contact_sheet(showcase, {"cell": "oracle/factored"})
        panels = {axes.get_title(): axes for part in figure.subfigs for axes in part.axes}
        flipped = panels["What if the coupling flips"]
        line = next(x for x in flipped.lines if x.get_label() == "counterfactual")
        assert np.array_equal(np.array(line.get_data()).T, showcase["counterfactual"][60:, 0])
        figures.save_png(figure, tmp_path / "sheet.png")
        assert (tmp_path / "sheet.png").stat().st_size > 10_000

    def test_film_strip_marks_each_body_in_each_frame(self):
        showcase = make_showcase()
        axes = contact_sheet(showcase, {}).subfigs[0].axes[0]
        count, (height, width) = len(showcase["frames"]), showcase["frames"].shape[1:3]
        chosen = np.unique(np.linspace(0, count - 1, 8).round().astype(int))
        assert [text.get_text() for text in axes.texts] == [
            f"{showcase['frame_times'][k]:+.2f} s" for k in chosen
        ]
        track = world_to_pixel(showcase["track"], (height, width), float(showcase["half_extent"]))
        marks = [np.ravel(line.get_data()) for line in axes.lines if line.get_marker() == "o"]
        bodies = track.shape[1]
        for place, (picture, k) in enumerate(zip(axes.images, chosen, strict=True)):
            left, right, bottom, top = picture.get_extent()
            assert (right - left, bottom - top) == pytest.approx((width, height))
            assert np.array_equal(picture.get_array(), showcase["frames"][k])
            here = np.array(marks[place * bodies : (place + 1) * bodies]) - (left, 0)
            np.testing.assert_allclose(here, track[k])


@pytest.fixture
def run_folder(tmp_path):
    """A run with one recording written and one that only has its showcase."""
    from safetensors.numpy import save_file

    run = make_run(tmp_path / "run", 1)
    write_recording(
        make_showcase(pictures=False),
        {"cell": "oracle/factored"},
        run / "recordings/oracle-factored.rrd",
    )
    (run / "showcase").mkdir()
    arrays = {k: np.ascontiguousarray(v) for k, v in make_showcase(pictures=False).items()}
    name = "anonymous-tracker-unstructured"
    about = {"cell": "anonymous-tracker/unstructured", "seed": "0"}
    save_file(arrays, run / "showcase" / f"{name}.safetensors", about)
    return run


CELLS_SHOWN = ("oracle-factored", "anonymous-tracker-unstructured")


class TestView:
    def test_arguments(self, run_folder):
        config = tyro.cli(ViewConfig, args=[str(run_folder), "--cell", "a/b", "c/d", "--web"])
        assert config == ViewConfig(run_folder, ("a/b", "c/d"), web=True)

    def test_a_missing_recording_is_drawn_from_its_showcase(self, run_folder, tmp_path, capsys):
        view(ViewConfig(run_folder, save=tmp_path / "out"))
        names = {path.stem for path in (tmp_path / "out").iterdir()}
        assert names == set(CELLS_SHOWN)
        entities = read_back(tmp_path / "out" / "anonymous-tracker-unstructured.rrd")
        assert "anonymous-tracker/unstructured" in str(entities["/about"])
        assert "wrote 2 recording(s)" in capsys.readouterr().out

    def test_parts_that_killed_ones_left_are_deleted_and_those_at_work_are_not(
        self, run_folder, tmp_path
    ):
        for process in (1, 2):
            part = tmp_path / "out" / f".oracle-factored.{process}.partial.rrd"
            part.parent.mkdir(exist_ok=True)
            part.write_bytes(b"half")
        os.utime(part, (0, 0))
        view(ViewConfig(run_folder, save=tmp_path / "out"))
        left = {path.name for path in (tmp_path / "out").iterdir()}
        assert left == {*(f"{name}.rrd" for name in CELLS_SHOWN), part.name.replace("2", "1")}

    def test_a_folder_that_is_half_filled_is_gone_on_with(self, run_folder, tmp_path, capsys):
        view(ViewConfig(run_folder, save=tmp_path / "out"))
        kept, lost = (tmp_path / "out" / f"{name}.rrd" for name in CELLS_SHOWN)
        whole, before = lost.read_bytes(), kept.stat().st_mtime_ns
        lost.unlink()
        capsys.readouterr()
        view(ViewConfig(run_folder, save=tmp_path / "out"))
        assert "wrote 1 recording(s)" in (said := capsys.readouterr().out)
        assert "1 lay there" in said
        assert (lost.read_bytes(), kept.stat().st_mtime_ns) == (whole, before)
        kept.write_bytes(whole)
        with pytest.raises(InputError, match=f"would overwrite .*{kept.name}"):
            view(ViewConfig(run_folder, save=tmp_path / "out"))
        assert kept.read_bytes() == whole

    def test_a_copy_that_is_broken_off_is_not_there(self, run_folder, tmp_path, monkeypatch):
        def half(source: Path, target: Path) -> None:
            target.write_bytes(source.read_bytes()[:100])
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(shutil, "copyfile", half)
            with pytest.raises(OSError, match="No space"):
                view(ViewConfig(run_folder, save=tmp_path / "out"))
        assert not [*(tmp_path / "out").iterdir()]
        view(ViewConfig(run_folder, save=tmp_path / "out"))

    def test_one_cell_is_shown_at_first_and_the_others_are_named(
        self, run_folder, monkeypatch, capsys
    ):
        called = fake_viewer(monkeypatch)
        monkeypatch.setenv("DISPLAY", ":0")
        view(ViewConfig(run_folder))
        assert [word for word in called[0][0] if ".rrd" in word] == [
            str(run_folder / "recordings/oracle-factored.rrd")
        ]
        assert "--cell all: anonymous-tracker/unstructured" in capsys.readouterr().out
        view(ViewConfig(run_folder, ("all",)))
        assert sum(".rrd" in word for word in called[1][0]) == 2

    def test_what_was_saved_is_opened_again(self, run_folder, tmp_path, monkeypatch):
        called = fake_viewer(monkeypatch)
        monkeypatch.setenv("DISPLAY", ":0")
        view(ViewConfig(run_folder, save=tmp_path / "both.rrd"))
        view(ViewConfig(tmp_path / "both.rrd"))
        assert called[-1][0][-1] == str(tmp_path / "both.rrd")

    def test_a_movie_is_of_one_cell_and_overwrites_nothing(self, run_folder, tmp_path, capsys):
        target = tmp_path / "still.png"
        config = ViewConfig(run_folder, ("anonymous-tracker/unstructured",), movie=target)
        view(config)
        assert "wrote" in capsys.readouterr().out and target.stat().st_size > 10_000
        with pytest.raises(InputError, match="exists"):
            view(config)
        with pytest.raises(InputError, match="no showcase of oracle/factored"):
            view(replace(config, cell=("oracle/factored",), movie=tmp_path / "other.png"))

    def test_a_skipped_cell_says_why(self, run_folder):
        with pytest.raises(InputError, match="videomae/factored has no recording: no weights"):
            view(ViewConfig(run_folder, ("videomae/factored",), web=True))

    def test_save_merges_into_one_file(self, run_folder, tmp_path):
        from rerun.chunk import RrdReader

        target = tmp_path / "both.rrd"
        view(ViewConfig(run_folder, save=target))
        assert len(RrdReader(str(target)).recordings()) == 2
        with pytest.raises(InputError, match="exists"):
            view(ViewConfig(run_folder, save=target))

    def test_web_serves_this_machine_only_and_says_how_to_get_there(
        self, run_folder, monkeypatch, capsys
    ):
        seen = {}

        def look():
            said = capsys.readouterr().out
            page = re.search(r"open +(http://127\.0\.0\.1:(\d+)/\S+)", said)
            seen["said"], seen["port"] = said, page[2]
            seen["page"] = urlopen(page[1]).read().decode()
            seen["recording"] = urlopen(f"{page[1]}0/oracle-factored.rrd").read()
            raise KeyboardInterrupt

        monkeypatch.setattr("vidphys.cli.view.wait", look)
        monkeypatch.setattr(viewer, "web_code", dict)
        view(ViewConfig(run_folder, ("oracle/factored",), web=True))
        assert f"-L {seen['port']}:127.0.0.1:{seen['port']} " in seen["said"]
        assert "<h1>oracle-factored</h1>" in seen["page"]  # it has no arrays to draw a still of
        file = run_folder / "recordings" / "oracle-factored.rrd"
        assert seen["recording"] == file.read_bytes()

    def test_a_display_opens_the_window(self, run_folder, monkeypatch):
        called = fake_viewer(monkeypatch)
        monkeypatch.setenv("DISPLAY", ":0")
        view(ViewConfig(run_folder, ("oracle/factored",)))
        assert called[0][0][-1].endswith("oracle-factored.rrd")
        fake_viewer(monkeypatch, code=3)
        with pytest.raises(RuntimeError, match="exit code 3"):
            view(ViewConfig(run_folder, ("oracle/factored",)))

    def test_no_display_says_what_to_do_and_writes_nothing(self, run_folder, monkeypatch):
        monkeypatch.setattr("viz.viewer.sys.platform", "linux")
        monkeypatch.delenv("DISPLAY", raising=False)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        with pytest.raises(InputError, match=r"--web .* --save"):
            view(ViewConfig(run_folder))
        assert len(list((run_folder / "recordings").iterdir())) == 1

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"run": Path("/nowhere/at/all")}, "not a folder"),
            ({"cell": ("oracle/factord",)}, "did you mean oracle/factored.*there are anonymous-tr"),
            ({"web": True, "save": Path("x.rrd")}, "exclude"),
            ({"save": Path("recording.mp4")}, "neither a .rrd file nor a folder"),
            ({"seeds": True, "cell": ("all",)}, "--seeds shows one cell"),
            ({"seeds": True, "web": False, "movie": Path("x.gif")}, "--seeds several"),
        ],
    )
    def test_bad_input_is_one_line(self, run_folder, change, message):
        with pytest.raises(InputError, match=message) as caught:
            view(replace(ViewConfig(run_folder, web=not change.get("save")), **change))
        assert "\n" not in str(caught.value)

    def test_a_run_without_recordings_and_a_broken_showcase(self, run_folder, tmp_path):
        with pytest.raises(InputError, match="no recordings"):
            view(ViewConfig(make_run(tmp_path / "bare", 1), web=True))
        (run_folder / "showcase" / "oracle-unstructured.safetensors").write_bytes(b"torn")
        with pytest.raises(InputError, match="cannot be read"):
            view(ViewConfig(run_folder, ("oracle/unstructured",), web=True))


def fake_viewer(monkeypatch, code=0):
    called = []
    monkeypatch.setattr("viz.viewer.sys.platform", "linux")

    def run(command, environment):
        called.append((command, environment))
        return code

    monkeypatch.setattr(viewer, "_run", run)
    return called


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX process groups")
def test_an_interrupted_viewer_leaves_no_process_behind(tmp_path):
    """rerun's launcher starts the viewer itself as a child, which outlives it."""
    pid = tmp_path / "pid"
    launcher = (
        "import pathlib, subprocess; child = subprocess.Popen(['sleep', '60']);"
        f"pathlib.Path({str(pid)!r}).write_text(str(child.pid)); child.wait()"
    )

    def interrupt(*_):
        if not (pid.exists() and pid.read_text()):
            signal.setitimer(signal.ITIMER_REAL, 0.1)
            return
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.1)
    try:
        assert viewer._run([sys.executable, "-c", launcher], dict(os.environ)) == 130
    finally:
        signal.signal(signal.SIGALRM, before)
    left = int(pid.read_text())
    for _ in range(1200):
        try:
            os.kill(left, 0)
        except ProcessLookupError:
            return
        if Path(f"/proc/{left}/stat").exists() and " Z " in Path(f"/proc/{left}/stat").read_text():
            return  # ended; whoever adopted it has not asked
        time.sleep(0.05)
    pytest.fail("the viewer's own process is still there")


def test_importing_costs_no_viewer_and_no_drawing():
    code = (
        "import sys, viz.recording, viz.report, viz.figures, viz.overlay, vidphys.cli.view;"
        "print([m for m in ('rerun', 'matplotlib', 'cv2', 'torch', 'mujoco') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (3.6e-6, "3.60e-6"), (0.99954, "0.99954"), (-0.1, "-0.1"), (1234.5, "1234")]
    + [(5e4, "5.00e4"), (0.001, "0.001")],
)
def test_numbers_are_short_and_true(value, text):
    assert number(value) == text


def test_what_a_page_holds_of_a_figure_is_short_and_the_same_to_the_eye():
    from viz.page import inline_png, inline_svg

    path = '<path id="x1.234" d="M 1.23456 2 \nL 3.5 4.999" style="fill: red"/>'
    uses = '<use id="mine" xlink:href="#x1.234" style="fill: red"/><use style="fill: blue"/>'
    svg = (
        f'<svg width="9"><!-- a -->\n <g id="b">\n  <g>{path}</g>\n<g clip="c">{uses}</g></g></svg>'
    )
    found = str(inline_svg(svg, "a").content)
    (name,) = re.findall(r"<style>\.(\w+){fill: red}</style>", found)
    assert found.replace(name, "NAME").replace(".NAME{fill: red}", "") == (
        '<svg role="img" aria-label="a"><style></style>'
        '<path id="x1.234" d="M 1.23 2 L 3.5 4.99" class="NAME"/>'
        '<g clip="c"><use xlink:href="#x1.234" class="NAME"/><use style="fill: blue"/></g></svg>'
    )
    shades = np.linspace(0, 255, 300 * 400).reshape(300, 400, 1).astype(np.uint8).repeat(3, 2)
    png = io.BytesIO()
    Image.fromarray(shades).save(png, "PNG")
    drawn = str(inline_png(png.getvalue(), "a").content)
    found = Image.open(io.BytesIO(base64.b64decode(drawn.split("base64,")[1].split('"')[0])))
    assert np.abs(np.asarray(found.convert("RGB")).astype(int) - shades).max() <= 4


def test_a_long_name_has_room_left_of_the_headline(tmp_path):
    run, name = make_run(tmp_path / "run", 1), "anonymous-tracker-twostage"
    rows = pq.read_table(run / "records.parquet").to_pylist()
    for row in rows:
        row["grounding"] = row["grounding"].replace("oracle", name)
    pq.write_table(pa.Table.from_pylist(rows, SCHEMA), run / "records.parquet")
    page = write_report(run).read_text()
    (x,) = re.findall(rf'class="name" x="([\d.]+)" y="[\d.]+">{name}<', page)
    assert float(x) >= 8 * len(name)  # pixels a letter, on a phone
