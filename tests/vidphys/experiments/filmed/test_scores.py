"""Scores of filmed clips: a right answer is right, a wrong one is not; numbers are converted."""

from dataclasses import replace

import numpy as np
import pytest

from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.filmed import table
from vidphys.experiments.filmed.answers import EXPLAINED, NOT, Answer, pixels_of
from vidphys.experiments.filmed.answers import told as told_number
from vidphys.experiments.filmed.byhand import forecast_by_hand
from vidphys.experiments.filmed.film import compose, truth_of
from vidphys.experiments.filmed.nuisances import Nuisances
from vidphys.experiments.filmed.scenes.kinds import KINDS
from vidphys.experiments.filmed.scores import Score, score
from vidphys.presets import PRESETS


def truth(kind, add=None):
    scene = KINDS[kind](np.random.default_rng(4))
    return truth_of(compose(scene, add or Nuisances(tilt=20.0, side=40.0), 0, 0, "mild"))


def right(told, quantities, terms, order=(0,)):
    """An answer that follows everything and foretells it."""
    track = told.steady[:, list(order)]
    begin = int(0.6 * len(track))
    groups = [{"bodies": list(range(len(order))), "moves on": "arc", "quantities": quantities}]
    forecast = told.stamps[begin:], track[begin:]
    return Answer(track, frozenset(terms), EXPLAINED, groups, forecast, 1.0)


def quantity(value, error):
    return {"value": value, "standard_error": error, "unit": "", "known": error < 0.15 * value}


def test_a_right_answer_is_exact_followed_and_its_numbers_are_in_their_intervals():
    told = truth("pendulum string")
    numbers = {n.name: n.value for n in told.numbers}
    said = {
        "rate": quantity(1.01 * numbers["omega"], 0.01 * numbers["omega"]),
        "linear friction": quantity(1.2 * numbers["damping"], 0.05 * numbers["damping"]),
        "length": quantity(numbers["length"], 0.1 * numbers["length"]),
    }
    found = score(told, right(told, said, {"pendulum", "linear"}))
    assert found.exact
    assert found.followed
    assert not found.wrong_and_sure
    by_name = {n.name: n for n in found.numbers}
    assert set(by_name) == {"omega", "damping", "length"}
    assert by_name["omega"].error == pytest.approx(0.01)
    assert by_name["omega"].inside
    assert by_name["damping"].error == pytest.approx(0.2)
    assert not by_name["damping"].inside
    assert by_name["length"].error == pytest.approx(0.0, abs=1e-9)
    assert found.forecast["model"] < 1e-9 < found.forecast["by hand"] < 0.5
    assert found.forecast["persistence"] > 5


def test_a_number_that_is_hardly_told_is_no_answer():
    told = truth("pendulum string")
    omega = next(n.value for n in told.numbers if n.name == "omega")
    for error, answered in ((0.1, True), (0.2, False)):
        said = {"rate": quantity(1.1 * omega, error * 1.1 * omega)}
        found = score(told, right(told, said, {"pendulum", "linear"}))
        (rate,) = (n for n in found.numbers if n.name == "omega")
        assert (rate.value is not None) is answered, error
        assert rate.refused is not answered
    (damping,) = (n for n in found.numbers if n.name == "damping")
    assert damping.value is None and not damping.refused  # nothing was said of it


def test_a_drag_is_hardly_told_where_it_and_the_length_are_so_together():
    """The product tells the friction of an angle; the drag is that over the length."""
    told = {"bodies": [0], "moves on": "arc", "quantities": {"length": quantity(0.5, 0.06)}}
    for error, known in ((0.06, True), (0.12, False)):
        told["quantities"]["square friction"] = quantity(1.0, error)
        assert told_number(told, "drag", 0).known is known


def test_a_sure_wrong_answer_counts_and_a_refusal_does_not():
    told = truth("bounce")
    wrong = score(told, replace(right(told, {}, {"uniform"}), forecast=None))
    assert wrong.wrong_and_sure
    assert wrong.numbers[0].value is None
    refused = score(told, Answer(np.full((0, 1, 2), np.nan), frozenset(), NOT, [], None, 1.0, "no"))
    assert not refused.wrong_and_sure
    assert not refused.followed
    assert refused.misses == (None,)


def test_bodies_are_matched_and_the_mass_ratio_turned_with_them():
    told = truth("pucks")
    ratio = next(n.value for n in told.numbers if n.name == "mass_ratio")
    said = {"mass ratio": quantity(1 / ratio, 0.01 / ratio)}
    found = score(told, right(told, said, {"collision"}, order=(1, 0)))
    assert found.followed
    assert found.numbers[0].error == pytest.approx(0.0, abs=1e-9)
    one = score(told, replace(right(told, said, {"collision"}), track=told.steady[:, :1]))
    assert not one.followed


def test_any_point_of_a_body_may_be_followed_but_always_the_same():
    told = truth("spring")
    answer = right(told, {}, {"trap", "linear"})
    beside = answer.track + 0.6 * told.radii[:, None] * [0, 1]
    assert score(told, replace(answer, track=beside, forecast=None)).misses[0] < 1e-9
    times, _ = answer.forecast
    goes_on = replace(answer, track=beside, forecast=(times, beside[-len(times) :]))
    assert score(told, goes_on).forecast["model"] < 1e-9
    beyond = answer.track + 2.0 * told.radii[:, None] * [0, 1]
    assert score(told, replace(answer, track=beyond, forecast=None)).misses[0] > 0.01
    slow = answer.track + 0.03 * told.size[0] * np.sin(told.times)[:, None, None]
    assert not score(told, replace(answer, track=slow, forecast=None)).followed


@pytest.mark.parametrize("kind", ["bounce", "fall", "two masses", "pendulum rod", "pendulum hand"])
def test_the_right_law_fitted_by_hand_foretells_the_rest(kind):
    told = truth(kind)
    noisy = told.steady + np.random.default_rng(0).normal(0, 0.5, told.steady.shape)
    noisy[5:8] = np.nan
    fitted = np.arange(len(told.times)) < 0.6 * len(told.times)
    off = (forecast_by_hand(told, noisy, fitted) - told.steady)[~fitted]
    assert np.sqrt((off**2).sum(-1).mean()) < 1.0


def test_pixels_are_counted_as_the_product_does():
    told = pixels_of(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.1]]), (360, 640))
    assert told == pytest.approx(np.array([[319.5, 179.5], [639.5, 179.5], [319.5, 147.5]]))


def test_the_table_records_shares_and_sizes_of_all_clips_and_of_each_part(monkeypatch, tmp_path):
    told = [truth("pendulum string"), replace(truth("bounce"), part="tilt")]
    omega = next(n.value for n in told[0].numbers if n.name == "omega")
    answers = [
        right(told[0], {"rate": quantity(1.05 * omega, 0.1)}, {"pendulum", "linear"}),
        right(told[1], {"acceleration": quantity(9.0, 2.0)}, {"uniform"}),
    ]
    scores = [score(t, a) for t, a in zip(told, answers, strict=True)]
    scores[0].write(tmp_path / "score.json")
    assert Score.read(tmp_path / "score.json") == scores[0]
    monkeypatch.setattr(table, "film_clip", lambda folder, seed, number: number)
    monkeypatch.setattr(table, "score_clip", lambda number: scores[number % 2])
    task = CellTask("filmed", "clips", (0,), PRESETS["quick"].oracle)
    table.run_clips(task)
    rows = {(r["cell"], r["metric"]): r["value"] for rec in task.recorders for r in rec.rows}
    assert rows["clips", "followed"] == 1.0
    assert rows["clips", "exact_structure"] == 0.5
    assert rows["clips", "sure_and_wrong"] == 0.5
    assert rows["clips/tilt", "sure_and_wrong"] == 1.0
    assert rows["clips/mild", "sure_and_wrong"] == 0.0
    assert rows["clips/pendulum-string", "omega_error_median"] == pytest.approx(0.05)
    assert rows["clips", "seconds_median"] == 1.0
    assert rows["clips/pendulum-string", "bias_mean"] == pytest.approx(0.05)
    assert rows["clips/pendulum-string", "bias_refused"] == 0.0
    assert rows["clips/tilt", "bias_refused"] == table.FEW / 2
    assert ("clips/tilt", "bias") not in rows


def test_a_forecast_that_a_body_stays_is_no_better_and_no_worse_than_that():
    told = truth("pendulum string")
    found = right(told, {}, {"pendulum"})
    times, places = found.forecast
    begin = len(told.times) - len(times)
    off = np.array([3.0, 4.0])  # whoever follows it may follow any point of it
    track = found.track + off
    track[begin - 1] += 1.0  # where it is seen last is not quite where it is
    still = np.broadcast_to(track[begin - 1], places.shape)
    stays = replace(found, track=track, forecast=(times, still), stays=True)
    one = score(told, stays)
    assert one.stays and one.forecast["model"] == one.forecast["staying"] > 5
    assert one.forecast["persistence"] != one.forecast["staying"]  # it knows where the body was
    assert not score(told, found).stays
