"""The report of reproduce: rows, verdicts, margins and drift curves from what lies on disk."""

import json
import re
from dataclasses import asdict

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core.figures import Panel, Sweep
from vidphys.runs.records import RECORD_SCHEMA
from viz.margins import DECADES, margin_figure
from viz.results import ALONG_STEPS, drift_along_steps, write_results
from viz.sweeps import lines_of, split_number, sweep_figure


def found(value, verdict, metric="m", bar="<= 2e-3", why="", values=None):
    row = {
        "id": "N1",
        "what": "a thing <of> note",
        "cell": "a",
        "metric": metric,
        "paper": "> 1e4",
        "bar": bar,
        "over": "mean",
    }
    seeds = ({} if value is None else {"0": value}) if values is None else values
    remark = "Because of this." if verdict == "missed" else ""
    return {
        "row": row,
        "values": seeds,
        "value": value,
        "verdict": verdict,
        "why": why,
        "remark": remark,
    }


def drift(cell, horizon, value, seed=0):
    empty = dict.fromkeys(RECORD_SCHEMA.names)
    named = {"experiment": "stability", "cell": cell, "metric": "energy_drift_median"}
    return {**empty, **named, "seed": seed, "horizon": horizon, "value": value, "status": "ok"}


@pytest.fixture
def run(tmp_path):
    rows = [
        found(1e-3, "met"),
        found(0.5, "missed", why="seed 1: failed"),
        found(None, "no number", why="not recorded"),
        found(None, "not asked for"),
        found(1.0, "reported", "regime_match", "", values={str(s): 1.0 for s in range(10)}),
    ]
    table = {
        "title": "T",
        "about": "What.",
        "ids": "N1",
        "records_of": "stability",
        "rows": rows,
        "sweeps": [],
    }
    about = {
        "code_version": "abc",
        "created": "2020-01-01T00:00:00",
        "settings": {"preset": "quick", "seeds": [0], "bars_sha256": "f0" * 32},
        "skipped": [{"cell": "stability/x", "reason": "failed: why"}],
    }
    (tmp_path / "run.json").write_text(json.dumps(about))
    swept = {**table, "sweeps": [asdict(Sweep((DRIFT,), "What holds."))]}
    (tmp_path / "verdicts.json").write_text(json.dumps({"one": swept, "two": table}))
    records = [drift("factored", h, 1e-3) for h in (100, 500, 2000)]
    pq.write_table(pa.Table.from_pylist(records, RECORD_SCHEMA), tmp_path / "records.parquet")
    return tmp_path


def test_the_report_says_every_row_and_lists_what_is_missed_first(run):
    html = write_results(run).read_text()
    rows, missed, margins = 2 * 4, 2 * 2, 2 * 3  # what was not asked for is in none of them
    assert html.count("a thing &lt;of&gt; note") == rows + missed + margins
    assert "10/10 seeds, p = 9.77e-4" in html
    assert "Of 6 figures with a bar that was registered before: 2 met, 2 missed, 2 no n" in html
    assert "Of the rows with a bar: 1 met, 1 missed, 1 no number, 1 not asked for." in html
    told = html[html.index("Not met") : html.index('id="one"')]
    assert told.count("<li>") == 4 + 1  # what was missed, of both tables, and what was skipped
    assert html.index("Not met") < html.index('id="one"')
    assert html.count("Because of this.") == 4  # in the list and in the row of both tables
    assert "stability/x: failed: why" in html and "f0f0" in html
    assert "http" not in html.replace("http://www.w3.org", "")


def test_confirmation_comes_first_and_development_is_greyed(run):
    held = json.loads((run / "verdicts.json").read_text())
    old = {**found(0.25, "missed"), "role": "development"}
    new = {**found(0.75, "met"), "role": "confirmation", "stale": True, "lost": {"100": [3, 64]}}
    held = {"one": {**held["two"], "rows": [new, old]}}
    (run / "verdicts.json").write_text(json.dumps(held))
    html = write_results(run).read_text()
    part = html[html.index('id="one"') :]
    fresh, grey = part.split("<h3>Seeds of development</h3>")
    assert ">0.75<" in fresh and ">0.25<" not in fresh
    assert "stale: the code has changed" in fresh and "3/64 episodes lost" in fresh
    assert grey.lstrip().startswith('<div class="scroll development"') and ">0.25<" in grey
    assert "stale" not in grey and "1 rows are stale" in html


def test_a_drift_figure_stands_once_for_tables_that_share_records(run):
    write_results(run)
    names = {path.name for path in (run / "figures").iterdir()}
    assert names == {"one-sweep-1.svg", "one-margins.svg", "one-drift.svg", "two-margins.svg"}


def test_a_folder_without_verdicts_is_refused(tmp_path):
    with pytest.raises(ValueError, match="cannot be read"):
        write_results(tmp_path)


def test_margins_are_decades_from_the_bar():
    rows = [
        found(2e-4, "met"),
        found(None, "no number"),
        found(-1.0, "met"),
        found(3.0, "met", bar=""),
    ]
    axes = margin_figure(rows).axes[0]
    marks = [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "o"]
    assert marks == pytest.approx([-1.0, -DECADES])
    assert [t.get_text() for t in axes.texts] == [" no number"]
    assert margin_figure([found(1.0, "met", bar="")]) is None
    assert margin_figure([found(1.0, "met", bar=">= 0")]) is None


def test_drift_is_drawn_for_cells_with_three_horizons_and_capped():
    rows = [drift("a", h, v) for h, v in ((100, 1e-2), (500, 1.0), (2000, 1e9))]
    rows += [drift("b", 100, 1.0), drift("b", 500, 1.0)]
    axes = sweep_figure(ALONG_STEPS, drift_along_steps(rows)).axes[0]
    curve = next(line for line in axes.lines if line.get_label() == "a")
    assert list(curve.get_xdata()) == [100, 500, 2000]
    assert list(curve.get_ydata()) == [1e-2, 1.0, 1e4]
    assert not any(line.get_label() == "b" for line in axes.lines)
    assert sweep_figure(ALONG_STEPS, drift_along_steps(rows[3:])) is None


def error(cell, value, coupling=None, seed=0, horizon=150):
    return drift(cell, horizon, value, seed) | {"metric": "inversion_nmse", "coupling": coupling}


DRIFT = Panel("energy_drift_median", "energy drift, 2,000 steps", horizon=2000)
ERROR = Panel("inversion_nmse", "error")


def test_a_sweep_over_the_coupling_has_a_point_for_each_and_a_cross_for_a_lost_seed():
    rows = [error("a", v, g, s) for s, g, v in ((0, -1, 1e-3), (1, -1, 1e-1), (2, -1, 1e-2))]
    rows += [error("a", 1.0, -0.5), error("a", None, -0.5, 1), error("b", None, -1.0)]
    rows += [error("a", 7.0, None), error("other", 7.0, -1.0)]
    panel = Panel("inversion_nmse", "error", cells="^[ab]$")
    axes = sweep_figure(asdict(Sweep((panel,), "", "coupling", "G")), rows).axes[0]
    curve = next(line for line in axes.lines if line.get_label() == "a")
    assert (list(curve.get_xdata()), list(curve.get_ydata())) == ([-1, -0.5], [1e-2, 1.0])
    crosses = [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "x"]
    assert sorted(crosses) == [-1.0, -0.5]
    assert sweep_figure(asdict(Sweep((panel,), "", "coupling")), rows[5:6]) is None


def test_a_panel_takes_the_records_of_its_coupling_and_horizon():
    rows = [error("a", 1.0, -1.0), error("a", 2.0, -0.5), error("a", 3.0, -1.0, horizon=50)]
    panel = asdict(Panel("inversion_nmse", "error", -1.0, 150))
    assert lines_of(panel, "", rows) == {"a": {0.0: [1.0]}}


@pytest.mark.parametrize(
    ("cell", "line", "number"),
    [
        ("factored/32", "factored", 32.0),
        ("guarantee/noise0.01", "guarantee", 0.01),
        ("a/b/curl-0.1", "a/b", 0.1),
        ("vjepa2", "vjepa2", None),
        ("truth", "truth", None),
    ],
)
def test_the_number_that_ends_the_name_of_a_cell(cell, line, number):
    assert split_number(cell) == (line, number)


def test_cells_below_each_other_are_named_once_for_all_panels():
    rows = [error("a", 1e-3), error("b", 1e-1), drift("b", 2000, 1e-2)]
    figure = sweep_figure(asdict(Sweep((ERROR, DRIFT), "")), rows)
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["a", "b"]
    assert [line.get_ydata()[0] for line in figure.axes[1].lines if line.get_marker() == "o"] == [1]


def test_the_cells_that_a_figure_selects_are_cells_of_its_table():
    for table in TABLES.values():
        for panel in (panel for sweep in table.sweeps for panel in sweep.panels):
            cells = TABLES[table.records_of].cells
            assert not panel.cells or sum(bool(re.search(panel.cells, c)) for c in cells) > 2
