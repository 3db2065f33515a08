"""Two marks on one body that is thrown and turns: its centre's law, with a lift by its spin."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.modelled import modelled
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.rigid import as_rigid
from vidphys.diagnose.recordings.units import Units
from vidphys.diagnose.telling.answers import answer

STEP = 0.0125
GRAVITY, SQUARE, LIFT, FADES, SPIN = 9.81, 0.4, -3.0, 0.2, -60.0
METRES = Units("m")


def flown(times, start, square=0.0, lift=0.0, fades=0.0):
    """Places ``(t, 2)`` of a centre of mass, by another solver than the product's."""

    def rate(t, state):
        v = state[2:]
        across = lift * np.exp(-fades * t) * np.array([-v[1], v[0]])
        return [*v, *(across - square * np.hypot(*v) * v - [0.0, GRAVITY])]

    solved = solve_ivp(rate, times[[0, -1]], start, t_eval=times, rtol=1e-10, atol=1e-12)
    return solved.y[:2].T


def marked(centre, angle, arms=(0.1, 0.3), noise=1e-3):
    """Motion of two marks on a body, on either side of its centre."""
    along = np.stack([np.cos(angle), np.sin(angle)], -1)
    both = np.stack([centre - arms[0] * along, centre + arms[1] * along], 1)
    return motion_of((both + np.random.default_rng(0).normal(0, noise, both.shape))[None], STEP)


def thrown(**law):
    times = np.arange(100) * STEP
    centre = flown(times, [0.0, 0.0, -4.0, 3.0], **law)
    return centre, marked(centre, SPIN * -np.expm1(-FADES * times) / FADES)


def test_two_marks_on_a_thrown_body_are_read_as_its_centre():
    centre, motion = thrown()
    found, (said,) = as_rigid(motion, METRES)
    assert np.sqrt(np.mean((found.positions[0, :, 0] - centre) ** 2)) < 1.5e-3
    assert found.spin_fades == pytest.approx(FADES, rel=0.05)
    assert "0.4 m apart" in said
    assert "0.25 of the way from 1 to 2" in said
    answered = answer(found, False, 0.3, units=METRES)
    assert answered.data["status"] == "explained"
    assert answered.data["terms"] == ["uniform"]
    told = answered.data["mechanism"][0]["quantities"]["acceleration"]
    assert abs(told["value"] - GRAVITY) < 3 * told["standard_error"] < 0.2


def test_what_is_seen_to_spin_may_be_lifted():
    centre, motion = thrown(square=SQUARE, lift=LIFT, fades=FADES)
    answered = answer(as_rigid(motion, METRES)[0], False, 0.3, units=METRES)
    assert answered.data["terms"] == ["lift", "square", "uniform"]
    assert answered.data["status"] == "explained"
    told = answered.data["mechanism"][0]["quantities"]
    for name, truth in (
        ("acceleration", GRAVITY),
        ("square friction", SQUARE),
        ("lift over speed, at first", LIFT),
    ):
        assert abs(told[name]["value"] - truth) < 3 * told[name]["standard_error"], name
        assert told[name]["standard_error"] < 0.05 * abs(truth), name
    assert np.abs(modelled(answered, centre, STEP) - centre).max() < 0.02
    times, path = answered.rolled["no spin"]
    last = round(times[0] / STEP)
    speed = (centre[last + 1] - centre[last - 1]) / (2 * STEP)
    alone = flown(times - times[0], [*centre[last], *speed], square=SQUARE)
    assert np.abs(path[:, 0] - alone).max() < 0.02


def test_a_lift_fades_with_the_spin():
    times = np.arange(100) * STEP
    numbers = np.array([0.0, -GRAVITY, SQUARE, LIFT])
    rolled = Law(2, "uniform", "square", lift_fades=FADES).roll(
        numbers, np.array([[0.0, 0.0], [-4.0, 3.0]]), times
    )
    exact = flown(times, [0.0, 0.0, -4.0, 3.0], square=SQUARE, lift=LIFT, fades=FADES)
    assert np.abs(rolled[:, 0] - exact).max() < 5e-5


def left_alone():
    times = np.arange(200) * STEP
    ones = np.zeros_like(times)
    circling = marked(np.stack([times, ones], -1), 8.0 * times, arms=(0.2, 0.2))
    yield "two bodies that circle each other", circling
    swing = 0.8 * np.sin(4.0 * times)
    upper = 0.5 * np.stack([np.sin(swing), -np.cos(swing)], -1)
    yield "two rods end on end", marked(upper, 9.0 * times, arms=(0.0, 0.3))
    fall = np.stack([times, -0.5 * GRAVITY * times**2], -1)
    yield "two that fly apart", marked(fall, 9.0 * times, arms=(0.0, 0.1 * (1 + times[:, None])))
    yield "a body that hardly turns", marked(fall, 1.0 * times)
    yield "a body that turns to and fro", marked(fall, 10.0 * np.sin(4.0 * times))


@pytest.mark.parametrize(("what", "motion"), list(left_alone()))
def test_others_are_left_as_they_are(what, motion):
    assert as_rigid(motion, METRES) == (motion, ()), what
