"""The figure of a diagnosis says which coordinate, which model, what is left, and where it is."""

import numpy as np
import pytest

from viz.diagnosis import diagnosis_figure

TIMES = np.arange(20) * 0.1
SEEN = np.random.default_rng(0).standard_normal((20, 2, 2))
CHANCES = {"pair": 0.9, "trap": 0.1}
ROLLED = {name: (TIMES[10:], SEEN[10:]) for name in ("model", "no friction")}


def labelled(figure):
    return {axes.get_ylabel() or axes.get_xlabel(): axes for axes in figure.axes}


def test_coordinates_and_curves_are_named_once():
    path = TIMES[4:], SEEN[4:] - [0.5, 0.25]
    figure = diagnosis_figure(
        TIMES, SEEN, ROLLED, path, said=["Explained."], unit="px", probability=CHANCES
    )
    axes = labelled(figure)
    chances = "probability that the scene has the term"
    rows = ["x1 (px)", "y1 (px)", "x2 (px)", "y2 (px)", "recorded − model (px)"]
    assert list(axes) == [*rows, "y (px)", chances]
    names = [text.get_text() for text in figure.subfigs[0].legends[0].get_texts()]
    assert names == ["recorded", "model", "model, foretold", "no friction", "held out"]
    np.testing.assert_array_equal(axes["x2 (px)"].lines[2].get_ydata(), SEEN[10:, 1, 0])
    assert [bar.get_width() for bar in axes[chances].patches] == list(CHANCES.values())
    left = {line.get_label(): line for line in axes[rows[-1]].lines}
    np.testing.assert_allclose(left["x1"].get_ydata(), 0.5)
    np.testing.assert_allclose(left["y2"].get_ydata(), 0.25)
    assert left["x1"].get_xdata()[0] == TIMES[4]
    assert figure.get_suptitle() == "Explained."


def test_terms_that_nobody_weighed_are_not_drawn_and_bodies_are_in_the_picture():
    picture = np.zeros((6, 12, 3), np.uint8)
    axes = labelled(diagnosis_figure(TIMES, SEEN, {}, picture=(picture, 4.0)))
    assert list(axes) == ["x1", "y1", "x2", "y2", "recorded − model", "y"]
    way = axes["y"]
    assert way.images[0].get_extent() == [-4.0, 4.0, -2.0, 2.0]
    np.testing.assert_array_equal(way.lines[1].get_xydata(), SEEN[:, 1])


def test_a_motion_on_a_line_has_no_plane():
    assert list(labelled(diagnosis_figure(TIMES, SEEN[..., :1], {}))) == [
        "x1",
        "x2",
        "recorded − model",
    ]


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_wall_stands_across_its_own_axis(axis):
    wall = {"axis": axis, "place": 0.3}
    *paths, _, _ = diagnosis_figure(TIMES, SEEN[:, :1], {}, wall=wall).axes
    drawn = {axes.get_ylabel(): [line.get_label() for line in axes.lines] for axes in paths}
    assert [name for name, lines in drawn.items() if "wall" in lines] == [axis]
