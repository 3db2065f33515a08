"""Reports of trade and stress: the result first, axes in words, nothing drawn where it is not."""

import json

import numpy as np
import pytest

from viz.stress import axis_figure, matrix, write_stress_report
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
    (axes,) = pareto_figure([point(1.0, 1e-3), point(9.0, 0.0)], "memory").axes
    drawn = [c.lines[0].get_ydata()[0] for c in axes.containers]
    assert drawn[0] == 1e-3 and 1e-5 < drawn[1] < 1e-3
    assert [text.get_text() for text in axes.texts] == ["0 (exact)"]
    assert axes.get_xlabel() == "µs per frame" and axes.get_ylabel() == "relative error"
    assert in_words("ms_per_clip") == "ms per clip" and in_words("nmse") == "nmse"
    figure = pareto_figure([point(1.0, 1e-3), point(1.3, 1e-4)], "memory")
    figure.canvas.draw()
    (axes,) = figure.axes
    assert not any(label.get_text() for label in axes.xaxis.get_minorticklabels())


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
