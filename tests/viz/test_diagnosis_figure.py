"""The figure of a diagnosis says which coordinate, which model, what is left, and where it is."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb, to_rgba

from viz.diagnosis import HELD, HUES, REFUSED, diagnosis_figure

TIMES = np.arange(20) * 0.1
SEEN = np.random.default_rng(0).standard_normal((20, 2, 2))
CHANCES = {"pair": 0.9, "trap": 0.1}
ROLLED = {name: (TIMES[10:], SEEN[10:]) for name in ("model", "no friction")}


def labelled(figure):
    return {axes.get_ylabel() or axes.get_xlabel(): axes for axes in figure.axes}


def test_every_body_is_drawn_along_every_axis_and_named_once():
    path = TIMES[4:], SEEN[4:] - [0.5, 0.25]
    figure = diagnosis_figure(
        TIMES, SEEN, ROLLED, path, said=["Explained."], unit="px", probability=CHANCES
    )
    axes = labelled(figure)
    chances = "probability of the term within the menu"
    rows = ["x (px)", "y (px)", "recorded − model (px)"]
    assert set(axes) == {*rows, chances}
    names = [text.get_text() for text in figure.subfigs[0].legends[0].get_texts()]
    assert names == [
        "body 1, recorded",
        "model",
        "foretold",
        "no friction",
        "body 2, recorded",
        "held out",
    ]
    seen = [line.get_ydata() for line in axes["x (px)"].lines if "recorded" in line.get_label()]
    np.testing.assert_array_equal(seen, SEEN[..., 0].T)
    lines = figure.axes[1].lines  # the second axis of the bodies
    foretold = [line.get_ydata() for line in lines if line.get_label() == "foretold"]
    np.testing.assert_array_equal(foretold, SEEN[10:, :, 1].T)
    assert [bar.get_width() for bar in axes[chances].patches] == list(CHANCES.values())
    left = {line.get_label(): line for line in axes[rows[-1]].lines}
    for name, value in {"x1": 0.5, "y1": 0.25, "x2": 0.5, "y2": 0.25}.items():
        np.testing.assert_allclose(left[name].get_ydata(), value)
    assert left["x1"].get_xdata()[0] == TIMES[4]
    assert figure.get_suptitle() == "Explained."


def test_the_hue_is_the_body_and_the_style_the_law():
    laws = {**ROLLED, "no pivot": (TIMES[10:], SEEN[10:])}
    lines = labelled(diagnosis_figure(TIMES, SEEN, laws))["x"].lines
    looks = {}
    for line in lines:
        looks.setdefault(line.get_label().partition(", ")[0], []).append(line)
    styles = {
        name: {line.get_linestyle() for line in looks[name]} for name in laws if name in looks
    }
    assert len(styles["no friction"]) == 1 and styles["no friction"] != styles["no pivot"]
    hues = [line.get_color() for line in looks["no friction"]]
    assert hues == [line.get_color() for line in looks["no pivot"]] and len(set(hues)) == 2


@pytest.mark.parametrize("colour", HUES)
def test_marks_stand_out_from_the_page(colour):
    def light(colour):
        parts = np.array(to_rgb(colour))
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722]

    for ground in ("#ffffff", HELD):
        assert (light(ground) + 0.05) / (light(colour) + 0.05) >= 3


def test_bars_of_terms_that_the_verdict_refuses_are_grey():
    axes = diagnosis_figure(TIMES, SEEN, {}, probability=CHANCES, holds=()).axes[-1]
    assert {bar.get_facecolor() for bar in axes.patches} == {to_rgba(REFUSED)}
    assert "the verdict refuses" in axes.get_xlabel()
    axes = diagnosis_figure(TIMES, SEEN, {}, probability=CHANCES, holds=["pair"]).axes[-1]
    assert [bar.get_facecolor() == to_rgba(REFUSED) for bar in axes.patches] == [False, True]


def test_terms_that_nobody_weighed_are_not_drawn_and_bodies_are_in_the_picture():
    picture = np.zeros((6, 12, 3), np.uint8)
    figure = diagnosis_figure(TIMES, SEEN, {}, picture=(picture, 4.0))
    names = [axes.get_ylabel() for axes in figure.axes]
    assert names == ["x", "y", "recorded − model", "y"]
    way = figure.axes[-1]
    assert way.images[0].get_extent() == [-4.0, 4.0, -2.0, 2.0]
    np.testing.assert_array_equal(way.lines[1].get_xydata(), SEEN[:, 1])


def test_a_motion_on_a_line_has_no_plane():
    assert list(labelled(diagnosis_figure(TIMES, SEEN[..., :1], {}))) == ["x", "recorded − model"]


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_wall_stands_across_its_own_axis(axis):
    wall = {"axis": axis, "place": 0.3}
    *paths, _, _ = diagnosis_figure(TIMES, SEEN[:, :1], {}, wall=wall).axes
    drawn = {axes.get_ylabel(): [line.get_label() for line in axes.lines] for axes in paths}
    assert [name for name, lines in drawn.items() if "wall" in lines] == [axis]
