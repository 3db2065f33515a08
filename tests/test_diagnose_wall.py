"""A wall that a body strikes: found with its numbers, and not where there is none."""

import numpy as np
import pytest

from vidphys.diagnose.answers import answer
from vidphys.diagnose.motion import motion_of
from vidphys.diagnose.wall import Wall, find_wall

STEP = 1 / 30
TRUE = Wall(0.3, 0.85, 16.0, 0.37, 0.3, -0.45, 0.0)


def stepped(wall, times, fine=100):
    """The same motion by small steps: none of the closed form that is under test."""
    s, v, out = wall.start, wall.speed, [wall.start]
    for a, b in zip(times, times[1:], strict=False):
        h = (b - a) / fine
        for _ in range(fine):
            v += h * (wall.stiffness * (wall.rest - s) - wall.rate * v)
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


def test_flights_follow_the_same_motion_in_small_steps():
    times = np.arange(90) * STEP
    np.testing.assert_allclose(TRUE.path(times), stepped(TRUE, times, 4000), atol=2e-3)


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


def test_a_swing_without_a_wall_has_none():
    assert find_wall(recorded(Wall(9.0, 0.85, 16.0, 0.0, 0.3, -0.45, 0.0))) is None


def test_bounces_are_said_rolled_on_and_changed():
    given = answer(recorded(), False, 0.3)
    assert "wall" in given.data and "a wall" in "\n".join(given.lines)
    described = given.specification
    assert described["explained"] and described["numbers"]["wall: restitution"]["value"] < 0.87
    errors = {k: v for k, v in given.numbers.items() if k.startswith("forecast_rmse")}
    assert errors["forecast_rmse_model"] < 0.02
    assert min(errors, key=errors.get) == "forecast_rmse_model"
    assert {"model", "half the length"} <= set(given.rolled)
