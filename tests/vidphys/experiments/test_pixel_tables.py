"""Tables that draw and see pictures, at tiny sizes."""

import pytest
import torch
from torch import Generator

from binders import Tracks
from dynamics import HEADS, Parameters, PhaseState
from encoders.cnn import ConvEncoder
from encoders.release import WeightsMissing
from readouts.local import RefinedReadout
from readouts.pooled import PooledReadout
from renderers import Camera, ChannelWorld, RgbWorld
from vidphys.data.clips import render_clips
from vidphys.experiments import study
from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core import bars, scoring
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_fixed_step, score_start
from vidphys.experiments.pixels import pixel_cell
from vidphys.experiments.pixels.consistency import latent_states
from vidphys.experiments.pixels.perception_speed import faster, score_rmse
from vidphys.experiments.pixels.readout_controls import pooled
from vidphys.experiments.pixels.seen import Perceived, Seen, draw, perceive, pixel_scene
from vidphys.metrics import nmse
from vidphys.perception.base import FitTask
from vidphys.perception.catalogue import RUNGS
from vidphys.perception.cnn import CHUNK, CnnPerception
from vidphys.perception.free_momentum import FreeMomentum
from vidphys.perception.own_cnn import OwnCnn, fit_own_cnn
from vidphys.perception.windows import WindowBatches
from vidphys.presets import OracleSizes, PixelSizes
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import Origin, Recorder, merged_tables
from vidphys.scenes import gravity
from vidphys.shooting.step import HEAD_DT

SIZES = PixelSizes(8, 8, 40, 32, 2, 8, 4, 4)


def run_cell(table, cell, seeds=(0,), folder=None):
    task = CellTask(table, cell, seeds, OracleSizes(1, 1, 1, (1.0,), 1), SIZES, folder=folder)
    TABLES[table].cells[cell](task)
    return merged_tables(task.recorders)[0].to_pylist()


def parts(rows, metric="inversion_nmse"):
    return {(r["cell"], r["seed"]) for r in rows if r["metric"] == metric}


@pytest.mark.parametrize(
    ("table", "cell", "expected"),
    [
        ("pixel-heads", "jepa", {"jepa/factored", "jepa/factored/joint"}),
        (
            "perception-speed",
            "speed-2",
            {"speed-2/factored/differencing", "speed-2/factored/shooting"},
        ),
    ],
)
def test_a_cell_leaves_records_of_every_part(table, cell, expected, tmp_path):
    rows = run_cell(table, cell, folder=tmp_path)
    assert parts(rows) == {(name, 0) for name in expected}
    names = {r["metric"] for r in rows}
    assert {"momentum_nmse", "ballistic_skill", "latent_growth", "in_distribution_nmse"} <= names
    assert {r["readout"] for r in rows} <= {"differencing", "shooting"}
    groundings = {"jepa", "jepa-joint"} if cell == "jepa" else {"cnn-supervised"}
    assert {r["grounding"] for r in rows} == groundings
    supervision = "none" if cell == "jepa" else "labels of 8 clips"
    assert {(r["supervision"], r["knows"], r["context"]) for r in rows} == {
        (supervision, "channels", 8)
    }


def test_one_perception_serves_all_heads_and_a_lost_head_stops_no_other(monkeypatch):
    fitted, trained = [], []

    def fit(grounding, seen, sizes, seed, head, *how):
        fitted.append(head)
        return "perception"

    def train(head, readout, task, perceived, recorder):
        trained.append(head)
        if recorder.origin.head == "gns":
            raise FloatingPointError("lost")
        recorder.add_value("inversion_nmse", 1.0)
        return None, None

    class Few(list):
        params, interval, times = None, 1.0, (0.0,)

    clips = Few()
    seen = Seen(clips, clips, Question(pixel_scene(), None, None, None))
    monkeypatch.setattr(pixel_cell, "draw", lambda *x: seen)
    monkeypatch.setattr(pixel_cell, "fit_perception", fit)
    monkeypatch.setattr(pixel_cell, "perceive", lambda *x: Perceived(seen, *[None] * 4))
    monkeypatch.setattr(pixel_cell, "train_and_score", train)
    rows = run_cell("pixel-heads", "renderer", (0, 1))
    assert len(fitted) == 2 and len(trained) == 12
    lost = {r["cell"] for r in rows if r["status"] == "failed"}
    assert lost == {"renderer/gns"}
    fitted.clear()
    cell = pixel_cell.PixelCell(RUNGS["jepa"], ("factored", "gns"))
    cell(CellTask("pixel-heads", "jepa", (0,), OracleSizes(1, 1, 1, (1.0,), 1), SIZES))
    assert fitted == ["factored", "gns"]


def test_faster_bodies_start_where_they_did():
    slow, fast = pixel_scene(), faster(pixel_scene(), 4.0)
    (a, _), (b, _) = (scene.sample(5, Generator().manual_seed(0)) for scene in (slow, fast))
    torch.testing.assert_close(b.q, a.q)
    torch.testing.assert_close(b.p, 4 * a.p)
    assert fast.settings["speed"] == 4.0 and "speed" not in slow.settings


def test_errors_of_the_start_are_in_world_units():
    task = CellTask("perception-speed", "speed-1", (0,), OracleSizes(1, 1, 1, (1.0,), 1), SIZES)
    recorder = task.recorder(0, pixel_scene(), "factored")
    truth = PhaseState(torch.zeros(4, 3, 2), torch.ones(4, 3, 2))
    start = PhaseState(truth.q + 0.5, truth.p - 2)
    score_rmse(recorder, Question(pixel_scene(), start, truth, None))
    value = {r["metric"]: r["value"] for r in recorder.rows}
    expected = {"position_rmse": 0.5, "momentum_rmse": 2.0, "mean_speed": 2**0.5}
    assert value == pytest.approx(expected)


def test_pixel_tables_are_asked_for_by_one_word():
    names = {table.name for table in study.choose(["pixels"])}
    assert {"probes", "pixel-heads", "perception-speed"} <= names


def test_the_pooled_control_differs_in_nothing_but_the_readout():
    spatial = RUNGS["hiera"]
    control = pooled(spatial)
    assert (control.name, control.world, control.share) == ("hiera-pooled", "rgb", spatial.share)
    assert control.fit.keywords == {**spatial.fit.keywords, "pooled": True}


def test_a_frozen_cnn_says_which_weights_it_has_and_encodes_each_frame_by_itself():
    torch.manual_seed(0)
    first, second = ConvEncoder(3, 4), ConvEncoder(3, 4)
    one, other = OwnCnn(first, 32), OwnCnn(second, 32)
    assert one.identity != other.identity and one.identity == OwnCnn(first, 32).identity
    frames = torch.randint(0, 255, (20, 3, 3, 32, 32), dtype=torch.uint8)
    found = one(frames, torch.arange(3.0))
    assert found.values.shape == (20, 3, 4, 16, 16)
    alone = one(frames[17:18, 1:2], torch.arange(1.0))
    torch.testing.assert_close(found.values[17, 1], alone.values[0, 0], rtol=1e-4, atol=1e-5)


def test_own_cnns_features_are_read_by_either_readout(tmp_path):
    sizes = PixelSizes(16, 4, 40, 32, 2, 8, 4, 4)
    world = RgbWorld(camera=Camera(height=32, width=32))
    clips = render_clips(pixel_scene(), world, 16, 4, 40, 0, "train")
    for control, kind in ((False, RefinedReadout), (True, PooledReadout)):
        perception = fit_own_cnn(FitTask(clips, sizes, 0, "factored"), control)
        assert isinstance(perception.reader.readout, kind)
        assert perception.tracks(clips).positions.shape == clips.states.q.shape


def test_an_encoder_without_weights_is_skipped_with_the_command_that_gets_it(tmp_path, monkeypatch):
    monkeypatch.setenv("VIDPHYS_WEIGHTS", str(tmp_path))
    with pytest.raises(WeightsMissing, match="`vidphys weights fetch vjepa2-g`"):
        run_cell("encoder-scale", "vjepa2-g")
    out = tmp_path / "run"
    run = RunFolder.open(out, {"cells": [], "seeds": [0]})
    run.skip("encoder-scale/vjepa2-g", "skipped: no weights")
    recorder = Recorder(Origin(*["encoder-scale", *["x"] * 7], 0, "cpu", "float32"))
    run.finish("x", *recorder.tables())
    table = study.write_verdicts(run, [TABLES["encoder-scale"]])["encoder-scale"]
    rows = {row["row"]["cell"]: row for row in table["rows"]}
    assert rows["vjepa2-g/factored"]["why"] == "skipped: no weights"
    assert rows["dinov2-small/factored"]["verdict"] == bars.UNASKED


def test_a_consistent_momentum_costs_nothing_and_any_other_does():
    world = ChannelWorld(Camera(height=32, width=32))
    clips = render_clips(pixel_scene(), world, 4, 6, 40, 0, "train")
    window = WindowBatches(clips, 5)[torch.arange(4)]
    head = pixel_scene().build(HEADS["factored"])
    losses = {}
    for weight in (0.0, 1.0):
        torch.manual_seed(0)
        perception = CnnPerception(3, 3, world.camera)
        latent = FreeMomentum(perception, head, world, 8, 10, weight)
        losses[weight] = float(latent.loss(window).detach())
    assert losses[1.0] > losses[0.0] + 0.01
    difference = torch.tensor([[-1.0, 0, 0, 0, 1, 0], [0, -1, 0, 0, 0, 1]]) / (2 * 8 * HEAD_DT)

    class Exact(torch.nn.Module):
        def forward(self, stack):
            return stack @ difference.T

    latent.momentum = Exact()
    found = []
    for latent.weight in (0.0, 1.0):
        latent.step.zero_()  # the same blur
        found.append(latent.loss(window))
    torch.testing.assert_close(*found)


def test_the_latents_residuals_are_of_the_frame_that_they_belong_to(tmp_path):
    world = ChannelWorld(Camera(height=32, width=32))
    clips = render_clips(pixel_scene(), world, 40, 5, 40, 0, "test")
    perception = CnnPerception(3, 3, world.camera)
    latent = FreeMomentum(perception, None, world, 8, 10, 1.0)
    truth = clips.states.q.float()
    perception.locate = lambda frames: next(chunks)
    chunks = iter(truth[:, -3:].split(CHUNK))
    found = latent_states(latent, clips)
    torch.testing.assert_close(found.q, truth[:, -2])


def test_every_rung_is_asked_about_the_same_motions_from_the_same_moment():
    scene = pixel_scene()
    rungs = ("renderer", "hiera", "i3d", "anonymous-hand", "rgb-tracked-blobs")
    seen = [draw(scene, RUNGS[name], SIZES, 0) for name in rungs]
    for one in seen:
        assert one.test.frames.shape[1] == one.train.frames.shape[1] == SIZES.frames
        assert torch.equal(one.asked.truth.q, seen[0].asked.truth.q)
        assert torch.equal(one.asked.truth.q, one.test.states.q[:, -1])


@pytest.mark.parametrize("identified", [True, False])
def test_tracks_get_the_true_numbers_only_where_bodies_look_alike(identified):
    seen = draw(pixel_scene(), RUNGS["renderer"], SIZES, 0)

    class Swapped:
        def tracks(self, clips):
            q = clips.states.q.flip(2)
            return Tracks(q, torch.ones(q.shape[:-1]), clips.times)

    found = perceive(Swapped(), seen, identified)
    assert torch.equal(found.test.positions, seen.test.states.q) == (not identified)
    assert torch.equal(found.under(None).positions, found.test.positions)
    assert found.head is None and RUNGS["hiera"].identified
    assert not RUNGS["composed"].identified


def test_a_law_is_told_from_its_start_by_two_other_starts():
    scene = pixel_scene()
    start, params = scene.sample(4, Generator().manual_seed(0))
    wrong = PhaseState(start.q + 1.0, start.p)
    task = CellTask("pixel-heads", "x", (0,), OracleSizes(1, 1, 1, (1.0,), 1), SIZES)
    recorder = task.recorder(0, scene, "factored")
    question = Question(scene, wrong, start, params)
    score_start(recorder, scene.law, question, start, "true_start")
    score_start(recorder, scene.law, question, wrong, "shared_start")
    rows = {(r["metric"], r["coupling"]): r["value"] for r in recorder.rows}
    assert len(rows) == 12
    for coupling in (-0.5, -1.0, -1.5):
        assert rows["inversion_nmse_from_true_start", coupling] < 1e-12
        assert rows["inversion_nmse_from_shared_start", coupling] > 0.1
        error = rows["inversion_nmse_from_shared_start", coupling]
        law = params.with_coupling(coupling)
        floor = nmse(question.straight_lines().states, question.reference(law).states).value
        skill = rows["ballistic_skill_from_shared_start", coupling]
        assert skill == pytest.approx(error / floor)


def test_the_share_of_steps_in_pieces_and_the_drift_without_them_are_told(monkeypatch):
    monkeypatch.setattr(scoring, "DRIFT_STEPS", (50, 100))
    scene = gravity("gaussian", mass=(1.0, 1.0))
    q = torch.tensor([[[-0.15, 0.0], [0.15, 0.0], [3.0, 3.0]]] * 2, dtype=torch.float64)
    q[1] = torch.tensor([[-3.0, 0.0], [3.0, 0.0], [0.0, 3.0]])
    p = torch.zeros_like(q)
    p[0, :2, 1] = torch.tensor([-1.0, 1.0])  # a narrow ellipse; the other three are far apart
    start = PhaseState(q, p)
    law = Parameters(torch.ones(2).double(), torch.ones(2, 3).double())
    head = gravity("gaussian").law
    head.dt = 0.01
    question = Question(scene, start, start, law)
    task = CellTask("pixel-heads", "x", (0,), OracleSizes(1, 1, 1, (1.0,), 1), SIZES)
    recorder = task.recorder(0, scene, "factored")
    rolled = question.ask(head, 100)
    score_fixed_step(recorder, head, question, rolled)
    value = {(r["metric"], r["horizon"]): r["value"] for r in recorder.rows}
    share = value["steps_in_pieces", None]
    assert share == rolled.split / (2 * 20) and 0.2 < share <= 0.5  # one of two episodes
    fixed = question.ask(head, 100, substeps=False)
    assert fixed.split == 0
    energies = [scene.energy(r.states, law) for r in (fixed, rolled)]
    drift = [float((e[:, -1] / e[:, 0] - 1).abs().max()) for e in energies]
    assert value["energy_drift_worst_fixed_step", 100] == pytest.approx(drift[0], rel=1e-6)
    assert drift[0] > 10 * drift[1]
