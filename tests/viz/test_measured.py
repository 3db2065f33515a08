"""Reports of trade and stress: the result first, axes in words, nothing drawn where it is not."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from viz.atlas_figures import Layer, Spot, cost_figure
from viz.stress import axis_figure, matrix, write_stress_report
from viz.sweeps import plain_ticks
from viz.trade_figures import in_words, pareto_figure


def point(cost, error, best=True):
    return {
        "front": "drawing",
        "task": "a disk",
        "configuration": {"memory": "small"},
        "cost": cost,
        "cost_low": 0.9 * cost,
        "cost_high": 1.1 * cost,
        "cost_name": "us_per_frame",
        "error": error,
        "error_name": "relative_error",
        "best": best,
    }


def test_an_error_of_zero_is_drawn_below_the_others_and_called_zero():
    (axes,) = pareto_figure([point(1.0, 1e-3), point(9.0, 0.0)], ["memory"]).axes
    drawn = [c.lines[0].get_ydata()[0] for c in axes.containers]
    assert drawn[0] == 1e-3 and 1e-5 < drawn[1] < 1e-3
    assert [text.get_text() for text in axes.texts] == ["0 (exact)"]
    assert axes.get_xlabel() == "µs per frame" and axes.get_ylabel() == "relative error"
    assert in_words("ms_per_clip") == "ms per clip" and in_words("nmse") == "nmse"
    figure = pareto_figure([point(1.0, 1e-3), point(1.3, 1e-4)], ["memory"])
    figure.draw_without_rendering()
    (axes,) = figure.axes
    assert not any(label.get_text() for label in axes.xaxis.get_minorticklabels())


def test_points_of_a_task_are_told_apart_by_all_settings_that_differ():
    settings = [
        {"dtype": name, "batch": n} for name in ("float32", "bfloat16") for n in (1, 2, 4, 8)
    ]
    settings += [{"store_dtype": "int8"}, {"store_dtype": "int8", "grid": 4}]
    rows = [{**point(k + 1.0, 1.0 / (k + 1)), "configuration": s} for k, s in enumerate(settings)]
    figure = pareto_figure(rows, ["runtime", "dtype", "batch", "store_dtype", "grid"])
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()][-2:] == [
        "store dtype int8",
        "store dtype int8, grid 4",
    ]
    marks = [c.lines[0] for c in figure.axes[0].containers]
    assert len({(mark.get_color(), mark.get_marker()) for mark in marks}) == len(settings)


@pytest.mark.parametrize("ends", [(0.022, 0.061), (15.5, 70), (0.41, 0.43), (1.2, 9), (1, 800)])
def test_ticks_of_a_short_logarithmic_axis_are_few_and_plain(ends):
    figure = Figure()
    axes = figure.subplots()
    axes.plot(ends, ends)
    axes.set(xscale="log")
    plain_ticks(axes, "x")
    low, high = axes.get_xlim()
    at = [x for x in axes.xaxis.get_majorticklocs() if low <= x <= high]
    words = axes.xaxis.get_major_formatter().format_ticks(at)
    assert 2 <= len(at) <= 5
    assert ends[1] == 800 or [float(word) for word in words] == pytest.approx(at)


def test_an_atlas_says_what_its_axes_are():
    layers = [Layer("tiny", str(k), k, 10.0 + 20 * k) for k in range(3)]
    spots = [Spot("tiny", str(k), "place", {"score": 0.1 * k}) for k in range(3)]
    figure = cost_figure(layers, spots, {"place": [("tiny", "2")]})
    figure.draw_without_rendering()
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("ms a clip", "score")
    assert {"20", "50"} <= {t.get_text() for t in axes.get_xticklabels()}


def cell(value, verdict="sound", error=1e-3, axis="softening"):
    return {
        "axis": axis,
        "name": f"{axis}/two/{value}",
        "system": "two bodies",
        "extreme": str(value),
        "value": value,
        "integrator": "leapfrog",
        "dtype": "float64",
        "path": "eager",
        "error": error,
        "bound": 1e-2,
        "verdict": verdict,
        "said": "",
    }


def test_an_axis_is_in_words_with_its_unit_and_zero_is_no_tiny_number():
    figure = axis_figure("softening", [cell(0.1), cell(0.01), cell(0.0)])
    (axes,) = figure.axes
    assert axes.get_xlabel() == "softening length (world units)"
    xs = axes.lines[0].get_xdata()
    assert min(xs) == pytest.approx(0.002) and [t.get_text() for t in axes.texts] == ["0"]
    assert axes.get_legend() is None and figure.legends


def test_every_cell_is_a_square_of_its_verdict():
    cells = [cell(0.1), cell(0.2, "warned"), *(cell(0.3) for _ in range(200))]
    (row,) = matrix({"softening": cells})["rows"]
    assert row["paths"]["sound"].count("M") == 201 and row["paths"]["warned"].count("M") == 1
    corners = row["paths"]["sound"].split("M")[1:]
    assert len(set(corners)) == 201  # none upon another


@pytest.mark.parametrize("wrong", [0, 1])
def test_the_first_sentence_says_the_result(tmp_path, wrong):
    cells = [cell(x) for x in np.logspace(-3, 0, 7)]
    cells += [cell(9.0, "silently wrong", 2.0)] * wrong
    counts = {"sound": 7, **({"silently wrong": 1} if wrong else {})}
    found = {"cells": cells, "counts": counts, "figures": [], "seconds": 1.0}
    about = {"settings": {"preset": "quick"}, "code_version": "abc"}
    (tmp_path / "verdicts.json").write_text(json.dumps(found))
    (tmp_path / "run.json").write_text(json.dumps(about))
    page = write_stress_report(tmp_path).read_text()
    first = page[page.index("<h1>") : page.index("</p>")]
    said = "1 of 8 cells was silently wrong." if wrong else "Nothing was silently wrong in 7 cells."
    assert said in first
