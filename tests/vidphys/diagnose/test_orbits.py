"""Bodies about one fixed place: the power of the distance is told by orbits of different sizes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.mechanisms.starts.orbits import orbiting
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer

STEP, FRAMES = 0.05, 60
PLACE = np.array([0.05, -0.02])
BEGUN = ((0.35, 0.3), (0.55, 2.1), (0.8, 4.4))  # distance and angle of each at first


def orbits(power, strength=0.4):
    """Three bodies ``(t, 3, 2)`` pulled to a place, each nearly on a circle."""
    r, angle = np.array(BEGUN).T
    place = np.stack([np.cos(angle), np.sin(angle)], -1) * r[:, None]
    speed = np.sqrt(strength * r ** (1 - power)) * [1.03, 0.97, 0.94]
    rate = np.stack([-np.sin(angle), np.cos(angle)], -1) * speed[:, None]

    def slope(_, state):
        s = state[:6].reshape(3, 2)
        a = -strength * s / np.linalg.norm(s, axis=1, keepdims=True) ** (power + 1)
        return np.concatenate([state[6:], a.ravel()])

    times = np.arange(FRAMES) * STEP
    state = np.concatenate([place.ravel(), rate.ravel()])
    rolled = solve_ivp(slope, (0, times[-1]), state, t_eval=times, rtol=1e-9, atol=1e-11).y[:6]
    return rolled.T.reshape(FRAMES, 3, 2) + PLACE


def seen(path, noise=0.001, seed=11):
    return motion_of(
        (path + noise * np.random.default_rng(seed).standard_normal(path.shape))[None], STEP
    )


@pytest.mark.parametrize("power", [2.0, pytest.param(1.0, marks=pytest.mark.slow), 2.5])
def test_the_power_of_the_distance_is_told(power):
    law = orbiting(frames_of(seen(orbits(power))), camera=False)[0]
    assert law.kinds == {"centre"}
    value, error = law.numbers["steeper"]
    assert abs(2 + value - power) < 3.5 * error < 0.1
    np.testing.assert_allclose(law.model.law.centre(law.numbers), PLACE, atol=0.01)


def test_planets_are_told_as_pulled_to_one_place():
    given = answer(seen(orbits(2.0)), False, 0.3, camera=True)
    assert given.data["terms"] == ["centre"] and given.data["status"] == "explained"
    assert "a fixed place pulls them" in " ".join(given.lines)
    (law,) = given.data["mechanism"]
    assert law["bodies"] == [0, 1, 2]
    np.testing.assert_allclose(law["centre"], PLACE, atol=0.02)
    power = law["quantities"]["power of the distance"]
    assert abs(power["value"] - 2.0) < 3 * power["standard_error"]


def test_springs_to_one_place_are_no_orbits():
    t = np.arange(FRAMES)[:, None] * STEP
    phase = np.array([0.3, 2.0, 4.1])
    path = np.stack([np.cos(3 * t + phase), 0.6 * np.sin(3 * t + phase)], -1) * 0.5
    assert answer(seen(path), False, 0.3).data["terms"] == ["trap"]


def test_bodies_on_one_circle_tell_no_power():
    angle = 2 * np.arange(FRAMES)[:, None] * STEP + np.array([0.3, 2.0, 4.1])
    path = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)
    assert orbiting(frames_of(seen(path, noise=1e-6)), camera=False) == []
