"""Flights beside a wall in closed form, which other steps are measured by."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from vidphys.stress.flights import Wall

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


@pytest.mark.parametrize("wall", [TRUE, BALL, replace(BALL, rate=0.5), replace(TRUE, rate=9.0)])
def test_flights_follow_the_same_motion_in_small_steps(wall):
    times = np.arange(90) * STEP
    np.testing.assert_allclose(wall.path(times), stepped(wall, times, 4000), atol=2e-3)


@given(st.floats(0, 6), st.floats(0, 9), st.floats(0, 6), st.floats(0.1, 3.0), st.booleans())
@example(0.0, 6.0, 3.0, 3.0, False)
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
