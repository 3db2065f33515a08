"""A body that a fixed place pushes or pulls: the place is found, though nothing is seen there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.modelled import modelled
from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.mechanisms.choose import fits_of
from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.mechanisms.kernels.motion import rolled
from vidphys.diagnose.mechanisms.starts.centre import centred
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer

STEP, FRAMES = 0.04, 60
PLACE = np.array([0.25, -0.35])


def passing(strength, power, start=(-1.2, 0.1), rate=(1.1, -0.05), frames=FRAMES, friction=0.0):
    """Places of a body that a fixed place pushes with ``strength`` at a distance of one."""

    def slope(_, state):
        away, rates = state[:2] - PLACE, state[2:]
        push = strength * away / np.linalg.norm(away) ** (power + 1)
        return [*rates, *(push - friction * rates)]

    times = np.arange(frames) * STEP
    span = (0.0, times[-1])
    return solve_ivp(slope, span, [*start, *rate], t_eval=times, rtol=1e-10, atol=1e-12).y[:2].T


def clips(path, seed, noise=0.002):
    noisy = path + noise * np.random.default_rng(seed).standard_normal(path.shape)
    return frames_of(motion_of(noisy[None, :, None], STEP))


@pytest.mark.parametrize("strength, power", [(0.3, 2.0), (0.05, 4.0), (-0.4, 2.0)])
def test_the_steps_are_those_of_another_integrator(strength, power):
    path = passing(strength, power)
    two, times = np.zeros(2), np.arange(FRAMES) * STEP
    start = np.array([[-1.2, 0.1], [1.1, -0.05]])
    centre = np.array([*PLACE, strength, power, 1.0, 0.0])
    walls = np.zeros((0, 5))
    out = rolled(times, start, two, np.zeros((2, 2)), two, np.zeros(3), walls, 1e-3, centre=centre)
    np.testing.assert_allclose(out[:, 0], path, atol=1e-6)


@pytest.mark.parametrize(
    "strength, power, seed",
    [
        pytest.param(0.3, 2.0, 41, marks=pytest.mark.slow),
        pytest.param(0.04, 4.0, 42, marks=pytest.mark.slow),
        (-0.4, 2.0, 43),
    ],
)
def test_a_fixed_place_is_found_with_its_power(strength, power, seed):
    best = fits_of(clips(passing(strength, power), seed), angles=False)[0]
    assert best.kinds == {"centre"}
    numbers = best.numbers
    for i in (0, 1):
        value, error = numbers[f"centre {i + 1}"]
        assert abs(value - PLACE[i]) < 3.5 * error and error < 0.1
    value, error = numbers["steeper"]
    assert abs(2 + value - power) < 3.5 * error
    assert np.sign(numbers["strength"][0]) == np.sign(strength)


def test_a_pull_that_grows_with_the_distance_is_found_with_its_power():
    path = passing(-3.0, -3.0, (0.9, -0.35), (0.0, 0.6), frames=200)
    best = fits_of(clips(path, 47, 0.001), angles=False)[0]
    value, error = best.numbers["steeper"]
    assert best.kinds == {"centre"} and abs(2 + value + 3) < 3.5 * error and error < 0.01
    given = answer(noisy(path[:, None], 0.001, STEP), False, 0.3)
    assert given.data["status"] == "explained"
    assert "by a power of the distance, with which it grows" in "\n".join(given.lines)


def test_an_orbit_that_friction_shrinks_is_found_with_both():
    path = passing(-1.0, 2.0, (1.25, -0.35), (0.0, 1.0), frames=400, friction=0.03)
    best = fits_of(clips(path, 46, 0.001), angles=False)[0]
    assert best.kinds == {"centre", "linear"}
    for name, truth in (("linear", 0.03), ("steeper", 0.0)):
        value, error = best.numbers[name]
        assert abs(value - truth) < 3.5 * error and error < 0.003


@pytest.mark.parametrize("seed", [44, pytest.param(45, marks=pytest.mark.slow)])
def test_no_fixed_place_is_told_of_a_flight_or_of_what_coasts(seed):
    times = np.arange(FRAMES) * STEP
    flight = np.stack([1.1 * times, 2 * times - 4.9 * times**2], -1)
    straight = np.stack([1.1 * times, 0.3 * times], -1)
    assert fits_of(clips(flight, seed), angles=False)[0].kinds == {"uniform"}
    assert fits_of(clips(straight, seed), angles=False)[0].kinds == frozenset()
    assert centred(clips(straight, seed)) == []


def test_the_model_of_a_fixed_place_moves_as_it_does():
    path = passing(-0.4, 2.0)
    given = answer(noisy(path[:, None], 0.002, STEP), False, 0.3)
    assert given.data["terms"] == ["centre"]
    assert np.abs(modelled(given, path, STEP) - path).max() < 0.02
