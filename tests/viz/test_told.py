"""The report of a training says at its top whether what was learned foretells."""

import html
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from viz.going_on import going_on_figure
from viz.told import write_told


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (0.1, "<b>Holds:</b> the factored model foretells better than standing still"),
        (0.2, "<b>Open:</b>"),
    ],
)
def test_a_training_says_first_whether_it_foretells(tmp_path, error, said):
    (tmp_path / "run.json").write_text(json.dumps({"settings": {"experiment": "train"}}))
    errors = {"clip/factored": error, "clip/persistence": 0.15, "clip/constant-velocity": 0.3}
    rows = [
        {"cell": cell, "metric": "forecast_rmse_normalised", "value": value, "status": "ok"}
        for cell, value in errors.items()
    ]
    pq.write_table(pa.Table.from_pylist(rows), tmp_path / "records.parquet")
    page = write_told(tmp_path).read_text()
    assert said in page and f"RMSE {error:g} against 0.15" in page


def test_a_diagnosis_says_first_what_moves_each_body_and_what_is_in_doubt(tmp_path):
    (tmp_path / "run.json").write_text(json.dumps({"settings": {"experiment": "diagnose"}}))
    lines = [
        "Frames 0 to 9 of 10 are used.",
        "Mostly explained: nearly all.",
        "Body 1 swings.",
        "  rate 1",
        "Body 2 falls.",
        "What is left is little.",
        "Nearly as likely: dry friction.",
        "In doubt: it does not rest.",
        "2 bodies, each seen.",
    ]
    (tmp_path / "summary.txt").write_text("\n".join(lines))
    page = write_told(tmp_path).read_text()
    assert "<b>Holds:</b> Mostly explained: nearly all. Body 1 swings. Body 2 falls.</li>" in page
    assert "<b>Open:</b> What is left is little. Nearly as likely: dry friction. In doubt:" in page


@pytest.mark.parametrize(
    ("raised", "said"),
    [
        (False, "<b>Holds:</b> the clip is like those of the training"),
        (True, "<b>Open:</b> the clip is unlike those of the training: twice its limit."),
    ],
)
def test_a_rollout_says_whether_its_clip_is_like_the_training_and_which_law_is_drawn(
    tmp_path, raised, said
):
    flag = {
        "name": "doubt",
        "value": 3.0,
        "limit": {"value": 2.0},
        "raised": raised,
        "said": "twice its limit",
    }
    settings = {"experiment": "rollout", "beyond": 1.0, "coupling": -1.0, "law": [], "stop": None}
    about = {"settings": settings, "flags": {"doubt": flag}}
    (tmp_path / "run.json").write_text(json.dumps(about))
    (tmp_path / "figures").mkdir()
    times, ahead = np.arange(5) * 0.1, 0.4 + np.arange(9) * 0.1
    rolled = np.random.default_rng(0).standard_normal((9, 2, 2))
    arrays = {"times": times, "track": rolled[:5], "rollout_times": ahead, "rollout": rolled}
    np.savez(tmp_path / "rollout.npz", **arrays, changed=-rolled)
    page = write_told(tmp_path).read_text()
    assert said in page and "nothing was recorded that far on" in page
    assert "<td>None</td>" not in page and ">coupling</th>" in page
    assert "under G = \u22121" in page


@pytest.mark.parametrize(("kind", "asked"), [("fit", ""), ("train", " CLIP")])
def test_what_is_said_to_roll_a_model_on_is_what_rollout_takes(tmp_path, kind, asked):
    (tmp_path / "run.json").write_text(json.dumps({"settings": {"experiment": kind}}))
    page = write_told(tmp_path).read_text()
    assert f"vidphys rollout {tmp_path.name}{asked} --beyond 5 --out runs/rolled" in page


def test_all_that_is_foretold_is_inside_and_another_law_may_leave():
    times, ahead = np.arange(5.0), 4 + np.arange(5.0)
    foretold = np.linspace(0, 8, 5)[:, None, None] * np.ones((5, 1, 2))
    rolled = {"foretold": (ahead, foretold), "under G = -1": (ahead, -100 * foretold)}
    figure = going_on_figure(times, np.zeros((5, 1, 2)), rolled)
    along = {axes.get_ylabel(): axes for axes in figure.axes if axes.get_xlabel() != "x"}
    for name in "xy":
        low, high = along[name].get_ylim()
        assert high >= 8 and -20 < low <= 0
        line = next(x for x in along[name].lines if x.get_label() == "under G = -1")
        assert line.get_linestyle() == "--"


def test_a_number_that_a_recording_does_not_tell_stands_there_by_its_limits(tmp_path):
    (tmp_path / "run.json").write_text(json.dumps({"settings": {"experiment": "diagnose"}}))
    rate = {"value": 2.0, "standard_error": 0.01, "unit": "1/s", "known": True}
    pull = {"value": 2045.3, "standard_error": 129.6, "unit": "px/s²", "known": True}
    friction = {"value": 0.5, "standard_error": 0.4, "unit": "", "known": False}
    told = {"rate": rate, "linear friction": friction, "acceleration": pull}
    group = {"bodies": [0], "quantities": told}
    found = {"schema_version": 1, "mechanism": [group]}
    (tmp_path / "diagnosis.json").write_text(json.dumps(found))
    page = write_told(tmp_path).read_text()
    assert ">body 1<" in page and "2.000 ± 0.020" in page and "2050 ± 250" in page
    assert "not told, between -0.284 and 1.28" in page and "0.50 ±" not in page


@pytest.mark.parametrize("mass, shown", [([1.5, 0.5], True), ([1.0, 1.0], False)])
def test_masses_stand_beside_the_numbers_that_are_told_for_them(tmp_path, mass, shown):
    (tmp_path / "run.json").write_text(json.dumps({"settings": {"experiment": "diagnose"}}))
    strength = {"pair: strength": {"value": 2.0, "standard_error": 0.1}}
    equation = {"text": "rᵢ'' = Σⱼ k d (rⱼ - rᵢ)/d", "symbols": {"pair: strength": "k"}}
    found = {"mass": mass, "parts": [{"quantities": strength, "equation": equation}]}
    (tmp_path / "diagnosis.json").write_text(json.dumps(found))
    page = html.unescape(write_told(tmp_path).read_text())
    assert "2.00 ± 0.20" in page and equation["text"] in page
    assert "pair: strength <i>k</i>" in page
    assert ("body 2" in page) == shown


def test_a_formula_stands_above_its_own_numbers_and_the_menu_s_are_left_out(tmp_path):
    (tmp_path / "run.json").write_text(json.dumps({"settings": {"experiment": "diagnose"}}))
    times = {"value": -4.0, "standard_error": 0.1, "unit": "1/s²"}
    words = [{"word": "tanh(k x)", "numbers": {"times": times}}]
    formula = {"equation": "x'' = -4 tanh(2 x)", "words": words}
    menu = [{"quantities": {"trap: stiffness": {"value": 7.0, "standard_error": 0.1}}}]
    found = {"mass": [1.0], "parts": menu, "formula": formula}
    (tmp_path / "diagnosis.json").write_text(json.dumps(found))
    page = html.unescape(write_told(tmp_path).read_text())
    assert "x'' = -4 tanh(2 x)" in page and "tanh(k x): times" in page
    assert "trap: stiffness" not in page
