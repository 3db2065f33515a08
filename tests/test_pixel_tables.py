"""Tables that draw and see pictures, at tiny sizes."""

import pytest
import torch
from torch import Generator

from dynamics import PhaseState
from vidphys.experiments import reproduce
from vidphys.experiments.ladder import pixel_scene
from vidphys.experiments.scoring import Question
from vidphys.experiments.tables import seeing
from vidphys.experiments.tables.base import CellTask
from vidphys.experiments.tables.catalogue import TABLES
from vidphys.experiments.tables.perception_speed import faster, score_rmse
from vidphys.perception.catalogue import GROUNDINGS
from vidphys.presets import OracleSizes, PixelSizes
from vidphys.records import merged_tables

SIZES = PixelSizes(8, 8, 40, 7, 32, 2, 8, 4, 4)


def run_cell(table, cell, seeds=(0,), folder=None):
    task = CellTask(table, cell, seeds, OracleSizes(1, 1, 1, (1.0,), 1), SIZES, folder=folder)
    TABLES[table].cells[cell](task)
    return merged_tables(task.recorders)[0].to_pylist()


def parts(rows, metric="inversion_nmse"):
    return {(r["cell"], r["seed"]) for r in rows if r["metric"] == metric}


@pytest.mark.parametrize(
    ("table", "cell", "expected"),
    [
        ("pixel-heads", "jepa", {"jepa/factored"}),
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
    assert {r["grounding"] for r in rows} == {"jepa" if cell == "jepa" else "cnn-supervised"}


def test_one_perception_serves_all_heads_and_a_lost_head_stops_no_other(monkeypatch):
    fitted, trained = [], []

    def fit(grounding, seen, sizes, seed, head, folder, progress):
        fitted.append(head)
        return "perception"

    def train(readout, head, *rest):
        trained.append(head)
        if head == "gns":
            raise FloatingPointError("lost")
        rest[5].add_value("inversion_nmse", 1.0)
        return None, None

    monkeypatch.setattr(seeing, "draw", lambda *x: None)
    monkeypatch.setattr(seeing, "fit_perception", fit)
    monkeypatch.setattr(seeing, "perceive", lambda *x: "tracks")
    monkeypatch.setattr(seeing, "train_and_score", train)
    rows = run_cell("pixel-heads", "renderer", (0, 1))
    assert len(fitted) == 2 and len(trained) == 12
    lost = {r["cell"] for r in rows if r["status"] == "failed"}
    assert lost == {"renderer/gns"}
    fitted.clear()
    cell = seeing.seen_cell(GROUNDINGS["jepa"], ("factored", "gns"))
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
    names = {table.name for table in reproduce.choose(["pixels"])}
    assert {"probes", "pixel-heads", "perception-speed"} <= names
