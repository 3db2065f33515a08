"""Units of work side by side, in a simulation; and what they took, from what they left."""

import json
import os
import time
from dataclasses import replace

import pyarrow as pa
import pytest
import torch

from tests.faults.test_processes import children_of
from tests.shared.small_studies import TINY
from vidphys.cli import main
from vidphys.cli.study import StudyOptions, work_units
from vidphys.errors import InputError
from vidphys.experiments import costs
from vidphys.experiments.core.cell import Unit
from vidphys.experiments.costs import Costs, growth, known_costs, pace_here
from vidphys.experiments.forecast import START_SECONDS, forecast
from vidphys.experiments.ladder import LADDER, cells_of
from vidphys.experiments.pace import step_seconds
from vidphys.experiments.study import run_unit, settings_of, units_of
from vidphys.presets import PRESETS, preset
from vidphys.runs.cost import Cost, cost_of
from vidphys.runs.folder import RunFolder
from vidphys.runs.needs import Needs
from vidphys.runs.schedule import makespan


def quiet(*_):
    pass


def units(*cells):
    return units_of([LADDER], [0], cells_of(cells))


def test_units_go_in_their_turn_to_whoever_is_free():
    assert makespan([], 2) == 0
    assert makespan([4, 3, 2, 1], 1) == 10
    assert makespan([4, 3, 2, 1], 2) == 5  # 4 + 1 and 3 + 2
    assert makespan([1, 1, 4], 2) == 5  # the long one came last
    assert makespan([4, 3, 2, 1], 64, start=2) == 6
    with pytest.raises(ValueError, match="`workers` 0"):
        makespan([1.0], 0)


@pytest.mark.slow
def test_the_ladder_that_was_measured_is_foretold():
    """Its times are of one run on two cores; another such run took 432 s."""
    rungs = [u for u in units() if Costs.ours().of(u, "quick", preset("quick"))[1] == "measured"]
    found = forecast(rungs, "quick", preset("quick"), Costs.ours())
    assert found.unknown == 0 and {how for _, how in found.known} == {"measured"}
    assert found.wall(2) == pytest.approx(432, rel=0.25)
    assert found.wall(10**6) - START_SECONDS["local"] == pytest.approx(max(found.seconds))


def test_a_run_says_what_its_units_took(tmp_path, monkeypatch):
    def cell(task):
        time.sleep(0.2)
        for seed in task.seeds:
            task.recorder(seed, "none", "none").add_value("x", 1.0)

    monkeypatch.setattr(type(LADDER.cells), "__getitem__", lambda _cells, _name: cell)
    unit = Unit(LADDER.name, ("oracle/factored",), (0, 1), ("oracle-factored-s0-1",))
    run = RunFolder.open(tmp_path / "run", settings_of("ladder", "quick", TINY, [unit], [LADDER]))
    run_unit(run.path, unit, TINY, "cpu", quiet)
    cost, how = known_costs([run.path]).of(unit, "quick", TINY)
    assert how == "measured" and 0.2 <= cost.seconds < 60
    alone = replace(unit, seeds=(0,))
    assert known_costs([run.path]).of(alone, "quick", TINY)[0].seconds == cost.seconds / 2
    assert cost.peak_bytes > 2**27  # torch alone
    assert known_costs([run.path], "cuda").of(unit, "quick", TINY) is None


def test_a_cell_takes_what_its_seeds_take_in_the_mean(tmp_path, monkeypatch):
    def cell(task):
        time.sleep(0.4 * task.seeds[0])
        task.recorder(task.seeds[0], "none", "none").add_value("x", 1.0)

    monkeypatch.setattr(type(LADDER.cells), "__getitem__", lambda _cells, _name: cell)
    units = [Unit(LADDER.name, ("oracle/factored",), (s,), (f"oracle-s{s}",)) for s in (1, 0)]
    run = RunFolder.open(tmp_path / "run", settings_of("ladder", "quick", TINY, units, [LADDER]))
    for unit in units:
        run_unit(run.path, unit, TINY, "cpu", quiet)
    took = [cost_of(part).seconds for part in run.parts()]
    cost, _ = known_costs([run.path]).of(units[0], "quick", TINY)
    assert abs(took[0] - took[1]) > 0.2
    assert cost.seconds == pytest.approx(sum(took) / 2)


def test_other_sizes_are_scaled_by_the_part_that_grows_most():
    quick, paper = PRESETS["quick"], PRESETS["paper"]
    known = Costs(
        {"quick": {"ladder/oracle/factored": Cost(10.0), "ladder/jepa/factored": Cost(5.0)}}
    )
    (oracle,), (jepa,) = units("oracle/factored"), units("jepa/factored")
    assert known.of(oracle, "paper", paper) == (Cost(10 * growth(quick, paper, False)), "scaled")
    assert known.of(jepa, "paper", paper) == (Cost(5 * growth(quick, paper, True)), "scaled")
    (other,) = units("rgb-tracked/factored")
    assert known.of(other, "quick", quick) == (Cost(7.5), "as others of its table")
    assert Costs().of(other, "quick", quick) is None


def test_what_is_known_of_both_sizes_tells_how_others_grow():
    known = Costs(
        {
            "quick": {f"ladder/{c}/factored": Cost(10.0) for c in ("renderer", "jepa", "oracle")},
            "standard": {"ladder/renderer/factored": Cost(70.0)},
        }
    )
    sizes = PRESETS["standard"]
    (jepa,), (oracle,) = units("jepa/factored"), units("oracle/factored")
    assert known.of(jepa, "standard", sizes) == (Cost(70.0), "scaled")
    by_sizes = 10 * growth(PRESETS["quick"], sizes, False)  # no other cell of true states is known
    assert known.of(oracle, "standard", sizes) == (Cost(by_sizes), "scaled")


def test_a_plan_is_printed_and_nothing_is_run(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["plan", "reproduce", "stability", "--workers", "3", "--units"]) == 0
    told = capsys.readouterr().out
    assert "with 3 workers" in told and "stability" in told and "measured" in told
    assert not list(tmp_path.iterdir())
    assert main(["plan", "reproduce"]) == 2
    assert "name a table" in capsys.readouterr().err


def at_pace(monkeypatch, pace):
    """A machine that takes so many times as long as that of our times."""
    seconds = pace * costs.step_seconds_of_ours()
    monkeypatch.setattr(costs, "step_seconds", lambda _workers: seconds)


def test_our_times_are_multiplied_by_this_machines_pace_and_measured_ones_are_not(monkeypatch):
    at_pace(monkeypatch, 3)
    cell = "ladder/oracle/factored"
    (oracle,), (jepa,) = units("oracle/factored"), units("jepa/factored")
    ours = [Costs.ours().of(unit, "quick", preset("quick"))[0].seconds for unit in (oracle, jepa)]
    here = Costs({"quick": {cell: Cost(10.0)}}).or_else(Costs.ours(pace_here(2)))
    found = forecast([oracle, jepa], "quick", preset("quick"), here, pace=pace_here(2))
    assert found.seconds == pytest.approx([10.0, 3 * ours[1]])
    assert found.wall(1) == pytest.approx(10 + 3 * ours[1] + START_SECONDS["local"])
    assert "times 3, by a measure of this machine" in found.sentence(1)


def test_a_plan_says_by_what_our_times_are_multiplied(monkeypatch, capsys):
    told = {}
    for pace in (1, 3):
        at_pace(monkeypatch, pace)
        assert main(["plan", "reproduce", "stability", "--json"]) == 0
        told[pace] = json.loads(capsys.readouterr().out)
        assert told[pace]["pace"] == pytest.approx(pace)
    assert told[3]["seconds"] == pytest.approx(3 * told[1]["seconds"])


def test_the_measure_of_a_machine_leaves_it_as_it_was():
    before = torch.get_num_threads(), torch.random.get_rng_state()
    children = children_of(os.getpid())
    assert 0 < step_seconds(2) < 60
    assert torch.get_num_threads() == before[0]
    assert torch.equal(torch.random.get_rng_state(), before[1])
    assert children_of(os.getpid()) == children


def test_a_unit_needs_the_memory_that_it_was_seen_to_take(tmp_path, monkeypatch):
    """In a run of the same preset; and of cards the share that the workers leave it."""
    unit, other = units("oracle/factored", "renderer/factored")
    settings = settings_of("ladder", "quick", TINY, [unit, other], [LADDER])
    run = RunFolder.open(tmp_path / "run", settings)
    table = pa.table({"seed": [0], "experiment": ["ladder"], "cell": list(unit.cells)})
    table = table.append_column("device", pa.array(["cpu"]))
    run.finish(unit.parts[0], table, table, cost=Cost(3.0, 2**30))
    new = RunFolder.open(tmp_path / "new", settings)
    options = StudyOptions(workers=2, measured=(run.path,))
    needs = [work.needs for work in work_units(new, [unit, other], TINY, options)]
    assert needs == [Needs(memory=2**30), Needs()]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,1")
    on_cards = replace(options, workers=8, device="cuda")
    assert [w.needs.gpu for w in work_units(new, [unit], TINY, on_cards)] == [0.25]
    elsewhere = replace(on_cards, engine="ray", address="auto")
    assert [w.needs.gpu for w in work_units(new, [unit], TINY, elsewhere)] == [0.125]


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError):
        known_costs([tmp_path])
