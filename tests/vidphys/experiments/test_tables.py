"""Tables of the study: bars that cannot drift, verdicts, ensembles, and cells at tiny sizes."""

import copy
import json
import math
import statistics
import tomllib

import pytest
import torch
from torch import Generator

from dynamics import HEADS, rollout
from vidphys.experiments import study
from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core import bars, truth
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.core.losses import energy_penalised, noisy
from vidphys.experiments.core.members import Examples, one_step, train_members
from vidphys.experiments.core.oracle import true_segments
from vidphys.presets import OracleSizes, PixelSizes, Preset
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import Origin, Recorder, merged_tables
from vidphys.scenes import gravity, lyapunov_time
from vidphys.shooting.step import roll
from vidphys.summary import Summary
from vidphys.training.ensemble import Ensemble, Stacked, stack
from vidphys.training.loop import FitSettings, fit
from vidphys.training.segments import scale_of, segment_loss
from viz.results import write_results

TINY = OracleSizes(32, 4, 64, (5e-3,), 4)
ROW = bars.Row("N1", "a thing", "a", "m", bar="<= 2")


def record(seed, value, cell="a", status="ok"):
    return {
        "cell": cell,
        "metric": "m",
        "coupling": None,
        "horizon": None,
        "seed": seed,
        "value": value,
        "status": status,
    }


# bars


@pytest.mark.parametrize("name", TABLES)
def test_every_table_has_rows_and_each_names_a_cell(name):
    rows, cells = bars.rows_of(name), TABLES[TABLES[name].records_of].cells
    assert rows
    for row in rows:
        for cell in (row.cell, row.divided_by or row.cell):
            owner = cell in cells or any(cell.startswith(f"{c}/") for c in cells)
            assert owner, f"{name}: {row.id} {cell}"


def test_every_remark_belongs_to_a_row_and_stands_only_where_a_bar_is_missed():
    remarks = tomllib.loads(bars.REMARKS.read_text(encoding="utf-8"))
    for table, entries in remarks.items():
        rows = {row.what: row for row in bars.rows_of(table)}
        for what, text in entries.items():
            missed = bars.Verdict(rows[what], {0: 1.0}, 1.0, bars.MISSED)
            assert bars.with_remark(table, missed).remark == text
            met = bars.Verdict(rows[what], {0: 1.0}, 1.0, bars.MET)
            assert bars.with_remark(table, met).remark == ""


def test_a_table_that_reads_anothers_records_has_no_cells_of_its_own():
    for table in TABLES.values():
        assert bool(table.cells) != bool(table.source)
        assert table.records_of in TABLES


def test_a_bar_is_met_only_if_every_seed_has_a_number():
    good = bars.judge(ROW, [record(0, 1.0), record(1, 3.0)])
    assert (good.value, good.verdict) == (2.0, bars.MET)
    lost = bars.judge(ROW, [record(0, 1.0), record(1, None, status="failed")])
    assert (lost.value, lost.verdict, lost.why) == (1.0, bars.MISSED, "seed 1: failed")
    none = bars.judge(ROW, [record(0, None, status="failed")])
    assert (none.value, none.verdict) == (None, bars.MISSED)
    assert bars.judge(ROW, []).why == "not recorded"


@pytest.mark.parametrize(
    ("over", "expected"), [("mean", 3.0), ("median", 2.0), ("largest", 6.0), ("smallest", 1.0)]
)
def test_seeds_are_joined_as_the_row_says(over, expected):
    row = bars.Row("N1", "", "a", "m", over=over)
    found = bars.judge(row, [record(s, v) for s, v in enumerate((1.0, 6.0, 2.0))])
    assert (found.value, found.verdict) == (expected, bars.REPORTED)


def test_ratios_are_taken_seed_by_seed_and_never_with_a_failed_twin():
    row = bars.Row("N1", "", "a", "m", divided_by="b", bar=">= 10", over="smallest")
    records = [record(0, 20.0), record(1, 30.0), record(0, 2.0, "b"), record(1, 1.0, "b")]
    assert bars.judge(row, records).value == 10.0
    records[-1] = record(1, None, "b", "failed")
    found = bars.judge(row, records)
    assert found.values == {0: 10.0} and found.verdict == bars.MISSED


def test_a_row_that_is_not_understood_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(bars, "FOLDER", tmp_path)
    line = 'row = [{ id = "N1", what = "x", cell = "a", metric = "m", bar = "around 2" }]'
    (tmp_path / "odd.toml").write_text(line)
    with pytest.raises(ValueError, match="row N1.*around 2"):
        bars.rows_of("odd")
    before = bars.bars_hash(["odd"])
    (tmp_path / "odd.toml").write_text(line.replace("around 2", "<= 2").replace("a", "b"))
    assert bars.bars_hash(["odd"]) != before


# models side by side


@pytest.fixture(scope="module")
def examples():
    return {seed: true_segments(gravity(), 32, seed) for seed in (0, 1)}


@pytest.mark.parametrize("name", ["factored", "symplectic", "unstructured", "neural-ode", "gns"])
def test_members_train_as_they_would_alone(name, examples):
    data = [examples[s][0] for s in examples]
    scale = scale_of(data[0])
    heads = []
    for seed in examples:
        torch.manual_seed(seed)
        heads.append(gravity().build(HEADS[name]))
        heads[-1].set_scale(scale.q, scale.p)
    ensemble = Ensemble(heads)

    def loss(head, batch):
        return one_step(head, batch, scale)

    settings = FitSettings(3, 32, 1e-3)
    fit(ensemble, ensemble.loss(loss), Stacked(data), settings, 0)
    for head, member, own in zip(heads, ensemble.members(), data, strict=True):
        alone = copy.deepcopy(head)
        fit(alone, segment_loss(alone, scale), own, settings, 0)
        for a, b in zip(alone.parameters(), member.parameters(), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-3, atol=2e-5)
        moved = [
            float((a - b).detach().abs().max())
            for a, b in zip(head.parameters(), member.parameters(), strict=True)
        ]
        assert max(moved) > 1e-4


def test_a_lost_member_does_not_take_the_others_along(examples):
    data = [examples[s][0] for s in examples]
    scale = scale_of(data[0])
    heads = [gravity().build(HEADS["factored"]) for _ in examples]
    with torch.no_grad():
        heads[1].potential.phi.layers[0].weight[0, 0] = math.nan
    ensemble = Ensemble(heads)
    loss = ensemble.loss(lambda head, batch: one_step(head, batch, scale))
    fit(ensemble, loss, Stacked(data), FitSettings(2, 16, 1e-3), 0)
    alive, lost = ensemble.members()
    assert all(bool(torch.isfinite(p).all()) for p in alive.parameters())
    assert not all(bool(torch.isfinite(p).all()) for p in lost.parameters())


def test_a_rate_at_which_a_member_is_lost_is_not_chosen(examples):
    """A lost member adds nothing to the loss in training; it must not look like a good score."""
    heads = [gravity().build(HEADS["factored"]) for _ in examples]
    train = {s: Examples(*examples[s]) for s in examples}

    def diverging(head, batch, scale):
        weight = head.potential.phi.layers[0].weight
        return one_step(head, batch, scale) + torch.where(weight.abs().max() > 3, math.nan, 0.0)

    recorders = {s: Recorder(Origin(*["x"] * 8, s, "cpu", "float32")) for s in examples}
    sizes = OracleSizes(32, 20, 32, (5.0, 1e-3), 4)
    make = iter(heads).__next__
    found = train_members("factored", make, train, sizes, recorders, diverging)
    rows = {r["metric"]: r for r in recorders[0].rows}
    assert rows["learning_rate"]["value"] == 1e-3 and set(found) == set(examples)
    assert rows["trial_error_at_rate_5"]["status"] == "failed"
    assert math.isfinite(rows["trial_error_at_rate_0.001"]["value"])


@pytest.mark.filterwarnings("error:There is a performance drop")
@pytest.mark.parametrize("name", ["factored", "factored-gns", "set-transformer"])
def test_mapped_rollouts_are_the_members_own(name):
    scene = gravity()
    start, params = scene.sample(3, Generator().manual_seed(0))
    start, params = start.map(torch.Tensor.float), params.map(torch.Tensor.float)
    heads = [scene.build(HEADS[name]) for _ in range(2)]
    with torch.no_grad():
        states = Ensemble(heads).map(
            lambda head, s, p: roll(head, s, p, 2, scene.dt, 2),
            stack([start, start]),
            stack([params, params]),
        )
    for i, head in enumerate(heads):
        own = rollout(head, start, params, 4, scene.dt, 2)
        torch.testing.assert_close(states.q[i], own.states.q[:, 1:], rtol=1e-5, atol=1e-6)


# losses of the baselines


def test_the_energy_penalty_grows_with_the_energy_that_is_lost(examples):
    scene, (batch, _) = gravity(), examples[0]
    scale = scale_of(batch)
    plain = one_step(scene.law, batch, scale)
    held = energy_penalised(scene, 100.0)(scene.law, batch, scale)
    # The reference itself changes its energy by next to nothing in a step.
    assert float(held - plain) < 1e-3
    head = scene.build(HEADS["unstructured"])
    head.set_scale(0.1, 0.1)
    with torch.no_grad():
        base = one_step(head, batch, scale)
        squared = energy_penalised(scene, 1.0)(head, batch, scale) - base
        tenfold = energy_penalised(scene, 10.0)(head, batch, scale) - base
        absolute = energy_penalised(scene, 1.0, "absolute")(head, batch, scale) - base
    torch.testing.assert_close(tenfold, 10 * squared, rtol=1e-3, atol=1e-5)
    assert not torch.isclose(absolute, squared, rtol=1e-3)
    with pytest.raises(ValueError, match="unknown form 'cubed'"):
        energy_penalised(scene, 1.0, "cubed")


def test_input_noise_is_to_be_undone_by_the_step(examples):
    batch, _ = examples[0]
    scale, law = scale_of(batch), gravity().law
    torch.manual_seed(0)
    assert float(noisy(0.0)(law, batch, scale)) == pytest.approx(float(one_step(law, batch, scale)))
    # The exact law carries the noise along, and so misses the noise-free target by it.
    noise = 3e-3 * float(batch.start.q.std())
    expected = (noise / scale.q) ** 2
    found = float(noisy(3e-3)(law, batch, scale))
    assert found > 0.9 * expected


def test_segments_of_several_steps_and_of_both_signs():
    train, held = true_segments(gravity(), 32, 0, k=5, both_signs=True)
    assert train.q.shape[1] == 5 and len(train) + len(held) == 32 * 16
    assert bool((train.params.coupling < 0).any()) and bool((train.params.coupling > 0).any())


# cells


@pytest.fixture
def hasty(monkeypatch):
    """A Lyapunov time over a hundredth of the usual number of steps."""
    monkeypatch.setattr(truth, "lyapunov_time", lambda *x: lyapunov_time(*x[:3], 4, 25))


@pytest.mark.parametrize(
    "cell",
    [
        "truth",
        pytest.param("factored-multi-step", marks=pytest.mark.slow),
        "energy-penalised-1",
        "gns-noise",
    ],
)
def test_a_cell_of_the_stability_table_leaves_records_of_every_seed(cell, hasty):
    task = CellTask("stability", cell, (0, 1), TINY)
    TABLES["stability"].cells[cell](task)
    records, episodes = merged_tables(task.recorders)
    rows = records.to_pylist()
    assert {r["seed"] for r in rows} == {0, 1} and {r["experiment"] for r in rows} == {"stability"}
    names = {r["metric"] for r in rows}
    assert {"inversion_nmse", "ballistic_skill", "force_cosine"} <= names
    wanted = "lyapunov_time" if cell == "truth" else "held_out_one_step_error"
    assert wanted in names and len(episodes) > 0
    if cell != "truth":
        assert_medians_come_from_the_episodes(rows, episodes.to_pylist())


def assert_medians_come_from_the_episodes(rows, episodes):
    """The study's table of drifts can be made from the raw record alone (C25)."""
    summaries = [r for r in rows if r["metric"] == "energy_drift_median"]
    assert {r["horizon"] for r in summaries} == {100, 500, 1000, 2000}
    for row in summaries:
        raw = [
            e["value"]
            for e in episodes
            if e["metric"] == "energy_drift"
            and (e["horizon"], e["seed"]) == (row["horizon"], row["seed"])
        ]
        assert len(raw) == row["episodes"] == TINY.held_out
        finite = [v for v in raw if v is not None]
        assert row["nonfinite"] == len(raw) - len(finite)
        if finite:
            assert row["value"] == statistics.median(finite)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("factored/32", marks=pytest.mark.slow),
        "unstructured/32",
        "symplectic/ring/softplus/128",
    ],
)
def test_a_cell_of_a_sweep_runs(name):
    table = "sensitivity" if "ring" in name else "data"
    task = CellTask(table, name, (0,), TINY)
    TABLES[table].cells[name](task)
    assert any(r["metric"] == "force_cosine" for r in task.recorders[0].rows)


# the verb


def test_an_unknown_table_is_refused_with_the_nearest_name():
    with pytest.raises(ValueError, match="did you mean 'stability'"):
        study.choose(["stabilty"])
    everything, pictures = study.choose(["all"]), study.choose(["pixels"])
    assert {t.name for t in everything}.isdisjoint(t.name for t in pictures)
    assert study.choose(["pixels", "all", "ladder", "filmed", "recorded"]) == tuple(TABLES.values())
    assert not {"ladder", "filmed"} & {t.name for t in (*everything, *pictures)}
    assert "stability" in {t.name for t in everything}


def theirs(task):
    task.recorder(0, "a pendulum", "mine").add_value("m", 2.0)


THEIRS = Table("theirs", "Theirs", "From elsewhere.", "-", {"a": theirs})


def test_a_table_from_an_import_path_is_run_as_ours_are(tmp_path):
    name = f"{__name__}:THEIRS"
    (table,) = study.choose([name])
    (unit,) = study.units_of([table], range(1))
    assert unit.table == name
    run = RunFolder.open(tmp_path / "run", {"cells": [], "seeds": []})
    study.run_unit(run.path, unit, Preset(1, TINY, None), "cpu", lambda *x: None)
    (row,) = run.join().to_pylist()
    assert (row["experiment"], row["cell"], row["system"]) == ("theirs", "a", "a pendulum")


def test_confirmation_is_judged_first_and_apart_from_development(tmp_path):
    run = RunFolder.open(
        tmp_path / "run",
        {
            "cells": ["stability/factored", "stability/truth"],
            "seeds": [0, 1, 100, 101],
            "asked": {"stability/factored": [0, 1, 100, 101], "stability/truth": [0]},
        },
    )
    for seed in (0, 1, 100):
        task = CellTask("stability", "factored", (seed,), TINY)
        drift = Summary(1e-3 if seed == 100 else 1.0, "ok", 4, 0)
        recorder = task.recorder(seed, "gravity", "factored")
        recorder.add("energy_drift_median", drift, None, 2000)
        run.finish(f"x{seed}", *merged_tables(task.recorders))
    rows = study.write_verdicts(run, [TABLES["stability"]])["stability"]["rows"]
    assert [r["role"] for r in rows] == sorted(r["role"] for r in rows)
    asked = {"metric": "energy_drift_median", "horizon": 2000, "cell": "factored"}
    first, second = [r for r in rows if asked.items() <= r["row"].items() and r["row"]["bar"]]
    assert (first["role"], first["values"]) == ("confirmation", {100: 1e-3})
    assert (first["verdict"], first["why"]) == (bars.MISSED, "seed 101: no record")
    assert (second["role"], second["values"]) == ("development", {0: 1.0, 1: 1.0})
    assert (second["verdict"], second["why"], second["stale"]) == (bars.MISSED, "", False)
    truth = {r["role"] for r in rows if r["row"]["cell"] == "truth"}
    assert truth == {"development"}  # it was asked for no seed of confirmation
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vidphys.runs.origin.code_hash", lambda _: "other")
        rows = study.write_verdicts(run, [TABLES["stability"]])["stability"]["rows"]
    assert {r["stale"] for r in rows if r["row"]["cell"] == "factored"} == {True}


def test_tables_that_share_models_train_them_once():
    units = study.units_of(study.choose(["inversion", "stability", "baselines"]), range(2))
    assert {u.table for u in units} == {"stability"}
    assert len(units) == len(TABLES["stability"].cells)
    some = study.units_of([TABLES["inversion"]], range(1), ["symplectic", "truth"])
    assert [u.cells for u in some] == [("truth",), ("symplectic",)]
    with pytest.raises(ValueError, match="unknown cell 'symplectc'; did you mean 'symplectic'"):
        study.units_of([TABLES["inversion"]], range(1), ["symplectc"])
    assert units[0].parts != study.units_of([TABLES["stability"]], range(3))[0].parts


def test_a_run_is_judged_reported_and_resumed(tmp_path, hasty):
    preset = Preset(1, TINY, PixelSizes(1, 1, 1, 1, 1, 1, 1, 1))
    tables = study.choose(["inversion"])
    units = study.units_of(tables, range(1), ("truth", "unstructured"))
    settings = study.settings_of("reproduce", "tiny", preset, units, tables)
    run = RunFolder.open(tmp_path / "run", settings)
    said = []
    for unit in units:
        study.run_unit(run.path, unit, preset, "cpu", lambda *x: said.append(x))
    run.skip("stability/symplectic", "skipped: no weights; fetch them")
    verdicts = study.write_verdicts(run, tables)
    rows = {row["row"]["what"]: row for row in verdicts["inversion"]["rows"]}
    assert rows["no force at all: error at G = -1"]["verdict"] == bars.REPORTED
    absent = rows["symplectic: force cosine at G = -1"]
    assert (absent["verdict"], absent["why"]) == (bars.ABSENT, "skipped: no weights; fetch them")
    assert rows["factored: force cosine at G = -1"]["verdict"] == bars.UNASKED
    report = write_results(run.path).read_text()
    assert "symplectic: force cosine" in report and settings["bars_sha256"] in report
    assert json.loads((run.path / "run.json").read_text())["settings"]["bars_sha256"]
    # A seed that was asked for and left no record is a miss, whoever made the others.
    more = study.units_of(tables, range(2), ("truth", "unstructured"))
    again = RunFolder.open(run.path, study.settings_of("reproduce", "tiny", preset, more, tables))
    rows = {r["row"]["what"]: r for r in study.write_verdicts(again, tables)["inversion"]["rows"]}
    short = rows["unstructured: force cosine at G = -1"]
    assert "seed 1: no record" in short["why"] and short["verdict"] == bars.MISSED
    again.skip("stability/unstructured", "failed: MemoryError")  # what was found stays
    rows = {r["row"]["what"]: r for r in study.write_verdicts(again, tables)["inversion"]["rows"]}
    assert rows["unstructured: force cosine at G = -1"] == short
    # Done work is not done again.
    said.clear()
    study.run_unit(run.path, unit, preset, "cpu", lambda *x: said.append(x))
    assert said == []
