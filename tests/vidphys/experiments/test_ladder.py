"""The ladder end to end at toy sizes: what it writes, that it resumes, what it refuses."""

from dataclasses import replace

import pyarrow.parquet as pq
import pytest
import torch
from torch import Generator

from registry import UnknownName
from tests.shared.small_studies import TINY
from vidphys.cli import ladder as verb
from vidphys.cli.console import Console
from vidphys.errors import InputError
from vidphys.experiments import ladder
from vidphys.experiments.core.bars import rows_of
from vidphys.experiments.ladder import ALL_HEADS, LADDER, TWINS, cells_of
from vidphys.experiments.pixels import pixel_cell
from vidphys.experiments.study import run_unit, settings_of, units_of
from vidphys.perception.catalogue import RUNGS
from vidphys.presets import OracleSizes, preset
from vidphys.runs.folder import RunFolder
from vidphys.seeding import derive


def quiet(_stage, _step, _steps):
    pass


# No pixels; alike to another; weights that a bare machine lacks; or an even number of frames.
LEFT_OUT = (
    "oracle",
    "jepa",
    "jepa-exact",
    "anonymous-tracker-twostage",
    "hiera",
    "composed-hiera",
    "i3d",
    "dinov2",
    "videomae",
    "videomae-pooled",
    "vjepa2-l",
    "vjepa2-h",
    "vjepa2-g",
    "vjepa2-ac",
    "videomae-tiny",
    "vjepa2-tiny",
)


VARIANTS = ("dino-tiny-anchored", "composed-proposals")  # of kinds that are read in another way
# Known, trained and frozen; the others are slow. Those that are followed learn in test_on_a_card.
EACH_WAY = ("renderer", "cnn-supervised", "dino-tiny")


def plan(names, heads, seeds):
    return units_of([LADDER], range(seeds), cells_of(names, heads))


def opened(path):
    units = plan((), (), 1)
    return RunFolder.open(path, settings_of("ladder", "tiny", TINY, units, [LADDER]))


def run_cell(run, cell, sizes=TINY, report=quiet):
    (unit,) = plan((cell,), (), 1)
    run_unit(run.path, unit, sizes, "cpu", report)


def unscored(monkeypatch, *names):
    """Leave out what takes long and is not asked about."""
    for name in names:
        monkeypatch.setattr(pixel_cell, f"score_{name}", lambda *_: None)


@pytest.fixture
def run(tmp_path):
    return opened(tmp_path / "run")


def heads_of(units):
    return {
        unit.cells[0].partition("/")[0]: tuple(cell.partition("/")[2] for cell in unit.cells)
        for unit in units
    }


def test_the_whole_ladder_is_every_rung_and_the_twins():
    units = plan((), (), 3)
    heads = heads_of(units)
    own = {name for name, rung in RUNGS.items() if not rung.of}
    assert len(units) == 3 * len(own) and set(heads) == own
    variants = heads_of(plan(("all",), (), 1))
    assert set(variants) == set(RUNGS) and variants["hiera-anchored"] == TWINS
    some = plan(("all", "oracle-32/symplectic"), (), 1)
    assert heads_of(some)["oracle-32"] == (*TWINS, "symplectic")
    assert heads["oracle"] == heads["renderer"] == ALL_HEADS
    assert heads["jepa-centroid"] == TWINS
    # Whole ladders first: all of seed 0 before any of seed 1.
    assert [u.seeds for u in units] == sorted(u.seeds for u in units)
    assert units[-1].parts[0] == units[-1].cells[0].replace("/", "-") + "-s2"


def test_cells_and_heads_are_chosen_by_name():
    units = plan(("oracle/factored", "oracle/symplectic", "jepa"), (), 1)
    assert heads_of(units) == {
        "oracle": ("factored", "symplectic"),
        "jepa": TWINS,
    }
    assert plan(("oracle",), ("factored-radial",), 1)[0].cells == ("oracle/factored-radial",)


@pytest.mark.parametrize(
    ("cells", "heads", "seeds", "words"),
    [
        (("orcale",), (), 1, "did you mean 'oracle'"),
        (("oracle/factord",), (), 1, "did you mean 'factored'"),
        ((), ("fctored",), 1, "did you mean 'factored'"),
        ((), (), 0, "at least one seed"),
    ],
)
def test_unknown_names_are_refused_with_the_nearest(cells, heads, seeds, words):
    with pytest.raises(ValueError, match=words):
        plan(cells, heads, seeds)


def test_the_verb_says_which_option_is_wrong(tmp_path):
    with pytest.raises(InputError, match="--cells.*unknown rung 'orcale'.*'oracle'"):
        verb.ladder(verb.LadderConfig(out=tmp_path / "run", cells=("orcale",)))
    assert not (tmp_path / "run").exists()


def test_a_rung_from_an_import_path_is_a_cell_as_ours_are():
    name = "vidphys.perception.palette:PALETTE_GROUNDING"
    assert cells_of((name,)) == (f"{name}/factored", f"{name}/unstructured")
    assert LADDER.cells[f"{name}/factored"].grounding is RUNGS["rgb-tracked"]
    with pytest.raises(UnknownName):
        LADDER.cells["oracle/fctored"]


def test_what_the_rungs_are_set_to_stands_in_the_settings(run):
    rungs = run.manifest()["settings"]["rungs"]
    assert rungs.keys() == {*(name for name, rung in RUNGS.items() if not rung.of), "shared"}
    assert rungs["oracle"]["supervision"] == "true states"


def test_the_studys_figures_are_those_of_its_tables():
    assert LADDER.settings["references"]["anonymous-tracker-twostage/factored"] == 0.16
    for row in rows_of("ladder"):
        assert (row.metric, row.coupling) == ("inversion_nmse", -1.0)
        # the study's momentum is by differencing, and only its own rows have its figure
        assert not (row.paper and row.bar) and not (row.bar and row.readout != "shooting")
        rung, _, head = row.cell.partition("/")
        assert rung in RUNGS and head in ALL_HEADS
    assert LADDER.settings["references"]["hiera-anchored/factored"] == 0.096


def test_the_studys_size_is_a_variant_of_the_oracle(run, monkeypatch):
    trained = {}

    def spied(task, name, term, scene, how, **told):
        start = how.examples(scene, 2, 0).train.start.q
        trained[told["grounding"]] = how.sizes(task.sizes).trajectories, start[0], told
        task.recorder(0, scene, name, **told)
        return []

    monkeypatch.setattr(ladder, "train_cell", spied)
    for cell in ("oracle/factored", "oracle-32/factored", "oracle-512/factored"):
        run_cell(run, cell)
    counts = {name: count for name, (count, _, _) in trained.items()}
    assert counts == {"oracle": TINY.oracle.trajectories, "oracle-32": 32, "oracle-512": 512}
    first, _ = ladder.oracle_scene().sample(2, Generator().manual_seed(derive(0, "train")))
    for name, (_, start, told) in trained.items():
        assert torch.equal(start.double(), first.q[0].float().double()) == (name != "oracle")
        assert (told["supervision"], told["knows"]) == ("true states", "nothing")


def test_unknown_preset_is_refused():
    with pytest.raises(InputError, match="quick, standard, paper"):
        preset("qick")


def test_the_oracle_rung_writes_every_metric(run):
    run_cell(run, "oracle/factored")
    rows = run.join().to_pylist()
    names = {r["metric"] for r in rows}
    assert {
        "inversion_nmse",
        "regime_match",
        "ballistic_skill",
        "force_cosine",
        "energy_drift_median",
        "energy_drift_worst",
        "energy_drift_slope",
        "in_distribution_nmse",
        "lyapunov_time",
        "learning_rate",
    } <= names
    couplings = {r["coupling"] for r in rows if r["metric"] == "inversion_nmse"}
    assert couplings == {-0.5, -1.0, -1.5}
    horizons = {r["horizon"] for r in rows if r["metric"] == "energy_drift_median"}
    assert horizons == {100, 500, 1000, 2000, 10_000}
    by_metric = {(r["metric"], r["coupling"]): r["value"] for r in rows}
    skill = by_metric["ballistic_skill", -1.0]
    expected = by_metric["inversion_nmse", -1.0] / by_metric["ballistic_nmse", -1.0]
    assert skill == pytest.approx(expected)
    # Every pooled error can be had again from the raw episodes.
    episodes = pq.read_table(run.path / "episodes.parquet").to_pylist()
    raw = [
        e["value"] for e in episodes if e["metric"] == "inversion_nmse" and e["coupling"] == -1.0
    ]
    assert sum(raw) / len(raw) == pytest.approx(by_metric["inversion_nmse", -1.0])


@pytest.mark.parametrize(
    "rung",
    [
        r if r in EACH_WAY else pytest.param(r, marks=pytest.mark.slow)
        for r in RUNGS
        if r in VARIANTS or r not in LEFT_OUT and not RUNGS[r].of
    ],
)
def test_a_pixel_rung_writes_both_readouts_and_resumes(run, rung):
    run_cell(run, f"{rung}/unstructured")
    rows = run.join().to_pylist()
    scored = [r for r in rows if r["metric"] == "inversion_nmse" and r["coupling"] == -1.0]
    fresh = [r["readout"] for r in scored if r["grounding"] == rung]
    trained_with = [r["readout"] for r in scored if r["grounding"] == f"{rung}-joint"]
    assert sorted(fresh) == ["differencing", "shooting"]
    assert sorted(trained_with) in ([], ["differencing", "shooting"])
    assert len(scored) == len(fresh) + len(trained_with)
    assert {r["metric"] for r in rows} >= {"position_nmse", "momentum_nmse"}
    before = run.join()
    calls = []
    run_cell(run, f"{rung}/unstructured", report=lambda *message: calls.append(message))
    assert not calls and run.join().equals(before)


@pytest.mark.slow
def test_a_rungs_heads_share_one_perception_but_for_a_joint_one(run, monkeypatch):
    fitted = []
    fit = pixel_cell.fit_perception

    def counted(grounding, seen, sizes, seed, head, folder, *how):
        fitted.append((head, folder.name))
        return fit(grounding, seen, sizes, seed, head, folder, *how)

    monkeypatch.setattr(pixel_cell, "fit_perception", counted)
    unscored(monkeypatch, "inversion", "retrace", "fixed_step", "start")
    for rung, expected in {
        "cnn-supervised": [("factored", "cnn-supervised-s0")],
        "jepa-centroid": [(h, f"jepa-centroid-{h}-s0") for h in TWINS],
    }.items():
        fitted.clear()
        (unit,) = plan((rung,), (), 1)
        run_unit(run.path, unit, TINY, "cpu", quiet)
        assert fitted == expected
        kept = sorted(p.parent.name for p in run.checkpoints(unit.parts[1]).rglob("head.json"))
        assert kept == ["differencing", "shooting"]
    assert run.showcase("jepa-centroid/factored").exists()
    seeds = {row["seconds"] is None for row in run.join().to_pylist()}
    assert seeds == {False}


def test_the_same_seed_gives_the_same_numbers(tmp_path, monkeypatch):
    unscored(monkeypatch, "retrace", "fixed_step", "start")
    values = []
    for name in ("a", "b"):
        run = opened(tmp_path / name)
        run_cell(run, "renderer/unstructured")
        rows = run.join().to_pylist()
        values.append([(r["metric"], r["value"]) for r in rows if r["metric"] != "seconds"])
    assert values[0] == values[1]


def test_a_diverged_training_is_counted_not_numbered(run):
    wild = replace(TINY, oracle=OracleSizes(32, 40, 64, (1e18,), 4))
    run_cell(run, "oracle/unstructured", wild)
    rows = [r for r in run.join().to_pylist() if r["metric"] == "inversion_nmse"]
    assert rows and all(r["status"] == "failed" and r["value"] is None for r in rows)
    assert all(r["nonfinite"] > 0 for r in rows)


@pytest.mark.slow
def test_report_and_recordings_are_drawn_from_what_lies_there(run):
    run_cell(run, "oracle/factored")
    run.join()
    report = verb.publish(run, Console(True, 1, "ladder"))
    assert "oracle" in report.read_text(encoding="utf-8")
    assert (run.path / "recordings" / "oracle-factored.rrd").stat().st_size > 1000
