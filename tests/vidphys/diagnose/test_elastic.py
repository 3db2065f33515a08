"""A weight on a spring of a rest length that hangs from a fixed place."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.modelled import modelled
from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations.verdict import EXPLAINED
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer

STEP, STIFFNESS, REST, GRAVITY = 0.02, 20.0, 1.0, 9.81


def hung(start, frames=400, pivot=0.0) -> np.ndarray:
    """Places ``(t, d)``, by another's integrator; up is the last axis."""
    d = len(start)

    def slope(_, y):
        r = np.linalg.norm(y[:d])
        a = -STIFFNESS * (r - REST) * y[:d] / r
        a[-1] -= GRAVITY
        return np.concatenate([y[d:], a])

    times = np.arange(frames) * STEP
    begin = np.concatenate([start, np.zeros(d)])
    found = solve_ivp(slope, (0, times[-1]), begin, t_eval=times, rtol=1e-10, atol=1e-12)
    return found.y[:d].T + pivot


@pytest.mark.parametrize(
    "start", [(0.6, -1.2), pytest.param((0.5, 0.3, -1.3), marks=pytest.mark.slow)]
)
def test_a_weight_that_swings_and_stretches_its_spring(start):
    path = hung(start, pivot=2.0)
    given = answer(noisy(path, 0.001, STEP), False, 0.3)
    assert given.data["terms"] == ["elastic"] and given.data["status"] == EXPLAINED
    told = given.data["mechanism"][0]["quantities"]
    truth = {"rate": STIFFNESS**0.5, "rest length": REST, "acceleration": GRAVITY}
    for name, value in truth.items():
        assert told[name]["value"] == pytest.approx(value, rel=0.01), name
    assert np.abs(modelled(given, path, STEP) - path).max() < 0.02


def test_a_spring_without_a_rest_length_stays_a_trap():
    times = np.arange(300) * STEP
    path = np.stack([np.cos(3 * times), 0.5 * np.sin(3 * times)], 1)
    given = answer(noisy(path, 0.002, STEP), False, 0.3)
    assert given.data["terms"] == ["trap"]


def test_a_rod_is_no_stiff_spring():
    """What swings in all directions of space on a rod."""

    def slope(_, y):
        q, v = y[:3], y[3:]
        return [*v, *(-(v @ v - GRAVITY * q[2]) / (q @ q) * q + [0, 0, -GRAVITY])]

    times = np.arange(400) * STEP
    start = [0.5, 0, -(0.75**0.5), 0, 0.8, 0]
    path = solve_ivp(slope, (0, times[-1]), start, t_eval=times, rtol=1e-10).y[:3].T
    given = answer(noisy(path, 0.002, STEP), False, 0.3)
    assert given.data["terms"] == ["string"] and given.data["status"] == EXPLAINED


def test_the_kernel_stretches_a_spring_from_a_fixed_place():
    law = Law(2, "elastic")
    numbers = np.array([STIFFNESS, REST, 0.0, 0.0, 0.0, -GRAVITY])
    rolled = law.roll(numbers, np.array([[0.6, -1.2], [0.0, 0.0]]), np.arange(100) * STEP)
    assert np.allclose(rolled[:, 0], hung((0.6, -1.2), 100), atol=1e-4)


def test_what_moves_freely_in_a_frame_that_turns_is_on_no_spring():
    """Such a spring has its way for a while, and then foretells another."""
    times, rate = np.arange(300) * 0.02, 0.8
    x, y = 0.5 - 0.1 * times, 0.25 * times
    c, s = np.cos(rate * times), np.sin(rate * times)
    noise = 1e-3 * np.random.default_rng(11).normal(size=(300, 2))
    path = np.stack([c * x + s * y, c * y - s * x], -1) + noise
    given = answer(motion_of(path[None, :, None], 0.02), False, 0.3)
    assert given.data["status"] == "not explained" or "elastic" not in given.data["terms"]
