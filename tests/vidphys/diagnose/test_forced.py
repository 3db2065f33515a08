"""Bodies that a sinusoid drives, which nobody recorded."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.modelled import modelled
from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations import doubts
from vidphys.diagnose.explanations.verdict import EXPLAINED, MOSTLY
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.telling.answered import Answered
from vidphys.diagnose.telling.answers import answer

STEP, FRAMES = 0.05, 400
DRIVE = "strongest acceleration by what drives it"


def moved(pull, start=(1.0, 0.0), step=STEP) -> np.ndarray:
    """Places ``(t, 1)`` under ``pull(s, v, t)``, by another's integrator."""
    times = np.arange(FRAMES) * step
    found = solve_ivp(
        lambda t, y: [y[1], pull(y[0], y[1], t)], (0, times[-1]), start, t_eval=times, rtol=1e-10
    )
    return found.y[:1].T


def told(places: np.ndarray, angles: bool = False) -> Answered:
    return answer(noisy(places, step=STEP), angles, 0.3)


def near(given: Answered, **truth: float) -> bool:
    known = given.data["mechanism"][0]["quantities"]
    return all(
        known[name]["value"] == pytest.approx(value, rel=0.01) for name, value in truth.items()
    )


def test_a_spring_that_is_driven_tells_of_what_drives_it():
    path = moved(lambda s, v, t: -4 * s - 0.2 * v + 1.5 * np.cos(3.1 * t + 0.4))
    given = told(path)
    assert given.data["terms"] == ["forcing", "linear", "trap"]
    assert given.data["status"] == EXPLAINED
    assert near(given, **{"rate": 2, "linear friction": 0.2, DRIVE: 1.5})
    assert near(given, **{"rate of what drives it": 3.1})
    assert np.abs(modelled(given, path, STEP) - path).max() < 0.01


def test_a_pendulum_that_is_driven_at_its_own_rate():
    swings = moved(lambda s, v, t: -4 * np.sin(s) - 0.3 * v + 0.5 * np.cos(2 * t), (0.2, 0.0))
    given = told(swings, angles=True)
    assert given.data["terms"] == ["forcing", "linear", "pendulum"]
    assert given.data["status"] == EXPLAINED
    assert near(given, **{"rate": 2, DRIVE: 0.5, "rate of what drives it": 2})


def test_a_body_tied_to_one_that_was_not_followed_may_be_driven_or_not():
    times = np.arange(FRAMES) * STEP
    given = told((np.cos(2 * times) + 0.6 * np.cos(2.9 * times))[:, None])
    assert given.data["status"] == MOSTLY and doubts.HIDDEN in given.lines


@pytest.mark.slow
def test_what_swings_by_itself_is_not_told_as_driven():
    path = moved(lambda s, v, t: 1.2 * (1 - s**2) * v - s)  # van der Pol
    given = told(path)
    assert given.data["status"] == EXPLAINED
    assert given.data["terms"] == ["formula", "linear", "placewise"]
    assert np.abs(modelled(given, path, STEP) - path)[:200].max() < 0.05


def test_what_drives_it_goes_on_where_it_was():
    law = Law(1, "trap", "linear", forced=True)
    numbers, start = np.array([4.0, 0.5, 0.1, 1.0, 0.4, 2.7]), np.array([[1.0], [0.0]])
    whole = law.roll(numbers, start, np.linspace(0, 8, 161))
    rest = law.roll(law.later(numbers, 3.0), whole[60], np.linspace(0, 5, 101))
    assert np.allclose(rest, whole[60:], atol=1e-5)


def test_nothing_drives_it_in_a_law_that_was_changed_so():
    given = told(moved(lambda s, v, t: -4 * s - 0.2 * v + 1.5 * np.cos(3.1 * t + 0.4)))
    times, path = given.rolled["nothing that drives it"]
    places = path[:, 0, 0]
    slope = np.gradient(places, times)
    pull = np.gradient(slope, times) + 4 * places + 0.2 * slope
    assert np.abs(pull[2:-2]).max() < 0.05 * np.abs(4 * places).max()
