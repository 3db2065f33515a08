"""Exponents of growth, and the picture of it."""

import json

import pytest

from benchmarks.axes import AXES
from benchmarks.growth import draw, exponent


def test_the_exponent_is_that_of_a_power_beside_which_calls_cost_something():
    sizes = (1, 10, 100, 1000, 10_000)
    assert exponent(sizes, [1e-5 + 1e-8 * n**2 for n in sizes]) == pytest.approx(2.0, abs=1e-2)
    assert exponent(sizes, [1e-5] * 5) is None


@pytest.mark.parametrize("name", [name for name in AXES if "bodies" in name or "frames (" in name])
def test_work_along_an_axis_is_done_and_its_peer_too(name):
    axis = AXES[name]
    assert axis.work(axis.sizes[0])() is not None
    if axis.peer is not None:
        assert axis.peer[1](axis.sizes[0])() is not None


def test_curves_are_drawn_on_axes_of_logarithms(tmp_path):
    curve = {"sizes": [1, 10], "seconds": [0.1, 1.0], "exponent": 1.0}
    lines = [
        {"axis": "bodies", **curve, "peer": {"name": "a script", **curve}},
        {"axis": "clips", **curve, "exponent": None},
    ]
    (tmp_path / "lines").write_text("\n".join(map(json.dumps, lines)), encoding="utf-8")
    draw(tmp_path / "lines", tmp_path / "growth.svg")
    assert "</svg>" in (tmp_path / "growth.svg").read_text(encoding="utf-8")
