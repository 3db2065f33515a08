"""A wall that a body strikes: found with its numbers, and not where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics import from_config, terms
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer
from vidphys.diagnose.wall.fit import find_wall
from vidphys.diagnose.wall.flights import Wall

STEP = 1 / 30
TRUE = Wall(0.3, 0.85, 16.0, 1.12, 0.3, -0.45, 0.0)
BALL = Wall(0.0, 0.8, 0.0, 9.8, 0.0, -1.5, 0.0)


def stepped(wall, times, fine=100):
    """The same motion by small steps: none of the closed form that is under test."""
    s, v, out = wall.start, wall.speed, [wall.start]
    for a, b in zip(times, times[1:], strict=False):
        h = (b - a) / fine
        for _ in range(fine):
            v += h * (wall.pull + wall.stiffness * (wall.place - s) - wall.rate * v)
            s += h * v
            if s > wall.place and v > 0:
                s, v = 2 * wall.place - s, -wall.restitution * v
        out.append(s)
    return np.array(out)


def recorded(wall=TRUE, frames=240, sign=1.0, noise=0.002):
    times = np.arange(frames) * STEP
    s = stepped(wall, times)
    q = np.stack([sign * s, 0.3 * s**2 - 0.6], -1)[None, :, None]
    return motion_of(q + noise * np.random.default_rng(0).standard_normal(q.shape), STEP)


@pytest.mark.parametrize("wall", [TRUE, BALL, replace(BALL, rate=0.5), replace(TRUE, rate=9.0)])
def test_flights_follow_the_same_motion_in_small_steps(wall):
    times = np.arange(90) * STEP
    np.testing.assert_allclose(wall.path(times), stepped(wall, times, 4000), atol=2e-3)


@given(st.floats(0, 6), st.floats(0, 9), st.floats(0, 6), st.floats(0.1, 3.0), st.booleans())
def test_a_flight_obeys_its_equation_of_motion_however_weak_its_terms(
    trap, weaker, friction, late, injects
):
    rate = (-1.0 if injects else 1.0) * 10.0**-friction
    wall = Wall(0.3, 0.8, 10.0 ** -(trap + weaker), 2.0, rate, 0.1, -0.4)
    flight = next(iter(wall.flights(1.0)))[2]
    h = 1e-4
    s, v = flight.at(late + h * np.arange(-1, 2))
    a = wall.pull + wall.stiffness * (wall.place - s[1]) - wall.rate * v[1]
    assert (s[2] - s[0]) / (2 * h) == pytest.approx(v[1], abs=1e-6)
    assert (v[2] - v[0]) / (2 * h) == pytest.approx(a, abs=1e-6)


def test_a_wall_begun_later_goes_on_as_before():
    times = np.arange(90) * STEP
    later = TRUE.later(float(times[40]))
    np.testing.assert_allclose(later.path(times[40:] - times[40]), TRUE.path(times)[40:], atol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_wall_is_found_with_its_numbers_on_either_side(sign):
    found = find_wall(recorded(sign=sign))
    assert found is not None and found.sign == sign and found.count >= 6
    assert found.wall.place == pytest.approx(TRUE.place, abs=0.005)
    assert found.wall.restitution == pytest.approx(TRUE.restitution, abs=0.02)
    assert found.wall.stiffness == pytest.approx(TRUE.stiffness, rel=0.03)
    assert found.left < 0.005


def thrown(wall=BALL, unit=1.0, second=1.0, noise=0.004):
    """A ball that flies on sideways while it bounces, in other units."""
    times = np.arange(120) * STEP
    q = np.stack([0.3 + 0.7 * times, -wall.path(times)], -1)[None, :, None]
    q = q + noise * np.random.default_rng(0).standard_normal(q.shape)
    return motion_of(unit * q, second * STEP)


@pytest.mark.parametrize("unit, second", [(1.0, 1.0), (300.0, 1e3), (1e-6, 1e-3)])
def test_a_bouncing_ball_shows_its_floor_and_gravity_in_any_units(unit, second):
    found = find_wall(thrown(unit=unit, second=second))
    assert found is not None and (found.axis, found.sign, found.bound) == (1, -1.0, False)
    assert found.wall.restitution == pytest.approx(0.8, abs=0.01)
    assert found.wall.pull == pytest.approx(9.8 * unit / second**2, rel=0.01)
    assert found.wall.stiffness == 0 and found.left < 0.01 * unit


def test_a_bouncing_ball_is_foretold_and_its_model_has_a_field_and_a_wall_and_no_term_more():
    given = answer(thrown(), False, 0.3)
    assert given.data["terms"] == ["uniform", "wall"]
    assert given.numbers["forecast_rmse_model"] < 0.02
    term = from_config(given.specification["terms"])
    field = (terms.NoPotential(), terms.Uniform())
    assert term.free == terms.Hamiltonian(potentials=field)
    assert (term.place, term.restitution) == pytest.approx((0.0, 0.8), abs=0.01)
    assert term.normal == (0.0, -1.0)


@pytest.mark.parametrize("stiffness", [0.5, 400.0])
def test_a_wall_beside_any_swing_is_found(stiffness):
    second = (16.0 / stiffness) ** 0.5
    whole = recorded()
    found = find_wall(replace(whole, times=second * whole.times))
    assert found is not None and found.wall.stiffness == pytest.approx(stiffness, rel=0.03)


def test_a_wall_that_takes_nothing_is_found_and_gives_nothing():
    found = find_wall(recorded(replace(TRUE, restitution=1.0, rate=0.0, pull=0.0)))
    assert found is not None and found.wall.rate == 0
    assert 0.995 < found.wall.restitution <= 1


def test_motions_that_only_turn_sharply_have_no_wall():
    t = np.arange(240) * STEP
    for s in (np.tanh(5 * np.sin(2 * t)), np.abs(t % 2 - 1), np.sin(2 * t) + 0.5 * np.sin(5.3 * t)):
        assert find_wall(motion_of(s[None, :, None, None], STEP)) is None


def test_a_swing_without_a_wall_has_none():
    assert find_wall(recorded(Wall(9.0, 0.85, 16.0, -144.0, 0.3, -0.45, 0.0))) is None


def test_bounces_are_said_rolled_on_and_changed():
    given = answer(recorded(sign=-1.0), False, 0.3)
    told = given.data["wall"]
    assert told["axis"] == "x" and told["place"] == pytest.approx(-TRUE.place, abs=0.01)
    assert f"strikes x = {told['place']:.4g}" in "\n".join(given.lines)
    described = given.specification
    assert described["explained"] and described["numbers"]["wall: restitution"]["value"] < 0.87
    errors = {k: v for k, v in given.numbers.items() if k.startswith("forecast_rmse")}
    assert errors["forecast_rmse_model"] < 0.02
    assert min(errors, key=errors.get) == "forecast_rmse_model"
    assert {"model", "half the length"} <= set(given.rolled)
