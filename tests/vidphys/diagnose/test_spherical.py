"""Weights on strings that swing to all sides, and round in circles, as motion capture sees them."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.modelled import modelled
from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations.verdict import EXPLAINED
from vidphys.diagnose.mechanisms.kernels.string import swung
from vidphys.diagnose.telling.answered import Answered
from vidphys.diagnose.telling.answers import answer
from vidphys.experiments.filmed.laws.law import GRAVITY

LENGTH, DAMPING, STEP, FRAMES = 0.8, 0.05, 1 / 60, 480
DOWN, PIVOT = np.array([0.0, 0.0, -GRAVITY]), np.array([0.3, -0.2, 1.9])


def swinging(angle: float, speed: float) -> np.ndarray:
    """Places ``(t, 1, 3)`` of a weight that is let go sideways, by another's integrator."""

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        q, v = y[:3], y[3:]
        force = DOWN - DAMPING * v
        return np.concatenate([v, force - (v @ v + force @ q) / LENGTH**2 * q])

    begin = LENGTH * np.array([np.sin(angle), 0, -np.cos(angle)])
    times = np.arange(FRAMES) * STEP
    start = np.concatenate([begin, [0, speed, 0]])
    found = solve_ivp(slope, (0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12)
    return found.y[:3].T[:, None] + PIVOT


def told(places: np.ndarray) -> Answered:
    return answer(noisy(places, 0.002, STEP), False, 0.3)


def level(angle: float) -> float:
    """The speed at which it goes round at one height."""
    return float(np.sqrt(GRAVITY * np.tan(angle) * LENGTH * np.sin(angle)))


@pytest.mark.parametrize(
    ("angle", "speed"),
    [
        pytest.param(0.25, 0.35, marks=pytest.mark.slow),
        pytest.param(0.9, 1.3, marks=pytest.mark.slow),
        (0.5, level(0.5)),
    ],
)
def test_a_weight_that_swings_to_all_sides_is_told_with_its_string(angle, speed):
    path = swinging(angle, speed)
    given = told(path)
    assert given.data["terms"] == ["linear", "string"] and given.data["status"] == EXPLAINED
    quantities = given.data["mechanism"][0]["quantities"]
    truth = {
        "length": LENGTH,
        "acceleration": GRAVITY,
        "linear friction": DAMPING,
        "rate": np.sqrt(GRAVITY / LENGTH),
    }
    for name, value in truth.items():
        rel = {"linear friction": 0.05, "rate": 1e-3}.get(name, 0.02)
        assert quantities[name]["value"] == pytest.approx(value, rel=rel)
        assert abs(quantities[name]["value"] - value) < 3 * quantities[name]["standard_error"]
    assert given.data["mechanism"][0]["pivot"] == pytest.approx(PIVOT, abs=0.03)
    text = "\n".join(given.lines)
    assert "goes slack" not in text and "m long" in text
    off = np.linalg.norm(modelled(given, path[:, 0], STEP) - path[:, 0], axis=1)
    assert off.max() < 0.05 * LENGTH


def test_the_kernel_keeps_a_weight_in_space_where_another_integrator_does():
    path = swinging(0.9, 1.3)[:, 0]
    start = np.array([path[0], [0.0, 1.3, 0.0]])
    string = np.array([*PIVOT, LENGTH])
    rolled = swung(np.arange(FRAMES) * STEP, start, string, DOWN, DAMPING, 1e-3)
    assert rolled[:, 0] == pytest.approx(path, abs=1e-6)


def test_on_a_circle_that_does_not_sink_no_string_is_told():
    turn = level(0.5) / (LENGTH * np.sin(0.5)) * np.arange(FRAMES) * STEP
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(FRAMES)], -1)
    given = told(LENGTH * np.sin(0.5) * circle[:, None])
    assert "string" not in given.data["terms"]


def test_a_spring_to_a_place_is_no_string():
    times = np.arange(FRAMES) * STEP
    path = np.exp(-0.03 * times)[:, None] * np.stack(
        [np.cos(3 * times), 0.6 * np.sin(3 * times), 0.3 * np.cos(3 * times + 1)], -1
    )
    assert told(path[:, None]).data["terms"] == ["linear", "trap"]
