"""The figure of a diagnosis says which coordinate, which model, and where the wall stands."""

import numpy as np
import pytest

from viz.diagnosis import diagnosis_figure

TIMES = np.arange(20) * 0.1
SEEN = np.random.default_rng(0).standard_normal((20, 2, 2))
CHANCES = {"pair": 0.9, "trap": 0.1}
ROLLED = {name: (TIMES[10:], SEEN[10:]) for name in ("model", "no friction")}


def test_coordinates_and_curves_are_named_once():
    figure = diagnosis_figure(TIMES, SEEN, CHANCES, ROLLED)
    *paths, terms = figure.axes
    assert [axes.get_ylabel() for axes in paths] == ["x1", "y1", "x2", "y2"]
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["recorded", "model, not fitted to these", "no friction"]
    np.testing.assert_array_equal(paths[2].lines[1].get_ydata(), SEEN[10:, 1, 0])
    assert [bar.get_width() for bar in terms.patches] == list(CHANCES.values())
    assert terms.get_xlabel() == "probability that the scene has the term"


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_wall_stands_across_its_own_axis(axis):
    figure = diagnosis_figure(TIMES, SEEN[:, :1], CHANCES, {}, {"axis": axis, "place": 0.3})
    *paths, terms = figure.axes
    drawn = {axes.get_ylabel(): [line.get_label() for line in axes.lines] for axes in paths}
    assert [name for name, lines in drawn.items() if "wall" in lines] == [axis]
    assert terms.get_xlabel().endswith("if there were no wall")
