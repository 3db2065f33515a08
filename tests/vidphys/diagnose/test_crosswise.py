"""Bodies that a force across their way turns: charges in a magnetic field, Foucault's pendulum."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.modelled import modelled
from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations import doubts
from vidphys.diagnose.explanations.verdict import EXPLAINED, MOSTLY
from vidphys.diagnose.mechanisms.kernels.motion import rolled
from vidphys.diagnose.telling.answered import Answered
from vidphys.diagnose.telling.answers import answer

STEP, FRAMES = 0.05, 300
FIELD = np.array([0.3, 0.2, 1.5])  # radians per second
TURNING = "turning"


def moved(pull, start) -> np.ndarray:
    """Places ``(t, 1, d)`` under ``pull(s, v)``, by another's integrator."""
    d, times = len(start) // 2, np.arange(FRAMES) * STEP

    def slope(_, y):
        return np.concatenate([y[d:], pull(y[:d], y[d:])])

    found = solve_ivp(slope, (0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12)
    return found.y[:d].T[:, None]


def told(places: np.ndarray) -> Answered:
    return answer(noisy(places, step=STEP), False, 0.3)


def quantity(given: Answered, name: str) -> float:
    return given.data["mechanism"][0]["quantities"][name]["value"]


def test_a_charge_drifts_in_a_magnetic_and_an_electric_field():
    places = moved(lambda _, v: [2 * v[1] + 0.8, -2 * v[0]], [0, 0, 1, 0.3])
    given = told(places)
    assert given.data["terms"] == [TURNING, "uniform"] and given.data["status"] == EXPLAINED
    assert quantity(given, TURNING) == pytest.approx(-2.0, rel=0.01)
    assert quantity(given, "acceleration") == pytest.approx(0.8, rel=0.01)
    _, path = given.rolled["nothing that turns it"]
    assert np.allclose(np.diff(path[:, 0, 1], 2), 0, atol=1e-6)  # steady along y
    assert np.abs(modelled(given, places[:, 0], STEP) - places[:, 0]).max() < 0.02


def test_a_charge_flies_on_a_helix_in_space():
    places = moved(lambda _, v: np.cross(v, FIELD), [0, 0, 0, 1, 0.3, 0.5])
    given = told(places)
    assert given.data["terms"] == [TURNING] and given.data["status"] == EXPLAINED
    about = [quantity(given, f"turning about {axis}") for axis in "xyz"]
    assert about == pytest.approx(-FIELD, abs=0.01)
    assert np.abs(modelled(given, places[:, 0], STEP) - places[:, 0]).max() < 0.02


def test_the_plane_of_a_pendulum_turns_slowly():
    turn = 0.05
    places = moved(lambda s, v: [-4 * s[0] + turn * v[1], -4 * s[1] - turn * v[0]], [1, 0, 0, 0])
    given = told(places)
    assert given.data["terms"] == ["trap", TURNING] and given.data["status"] == EXPLAINED
    assert quantity(given, "rate") == pytest.approx(2.0, rel=1e-3)
    assert quantity(given, TURNING) == pytest.approx(-turn, rel=0.05)


def test_an_ellipse_of_a_wide_pendulum_is_not_told_as_turned_for_sure():
    """What hangs on a string, seen from above: its ellipse turns by itself."""

    def hangs(s, v):  # on a sphere of radius one, g = 4
        up = np.sqrt(1 - s @ s)
        along = (s @ v) ** 2 / (1 - s @ s) + v @ v
        return -s * (4 * up + along)

    given = told(moved(hangs, [0.3, 0, 0, 0.25]))
    assert given.data["status"] != EXPLAINED or TURNING not in given.data["terms"]
    assert TURNING not in given.data["terms"] or doubts.PRECESSES in given.lines


def test_on_a_spiral_a_force_across_is_as_likely_as_a_pull():
    given = told(moved(lambda _, v: [2 * v[1] - 0.1 * v[0], -2 * v[0] - 0.1 * v[1]], [0, 0, 1, 0]))
    assert given.data["status"] == MOSTLY and doubts.CIRCLES in given.lines


@pytest.mark.parametrize("field", [[0, 0, 0.2], [0.05, 0.12, 0.16]])
def test_a_part_of_a_circle_in_space_does_not_tell_a_force_across_from_a_pull(field):
    """As a month of a planet's way: also where its plane is any."""
    across = np.cross(field, [1.0, 0.3, 0.5])
    given = told(moved(lambda _, v: np.cross(v, field), [0, 0, 0, *across]))
    assert given.data["status"] == MOSTLY and doubts.CIRCLES in given.lines


@pytest.mark.parametrize("axes", [slice(0, 3), slice(2, 3)])
def test_the_kernel_turns_a_speed_about_an_axis(axes):
    """The speed keeps its length, and its share along the field."""
    field, size = FIELD[axes], 3 if axes.start == 0 else 2
    start = np.zeros((2, size))
    start[1] = np.array([1.0, 0.3, 0.5])[:size]
    none = np.zeros(size)
    times = np.linspace(0, 5, 101)
    v = rolled(
        times, start, none, np.zeros((size, size)), none, np.zeros(3), np.zeros((0, size + 3)),
        0.01, turning=field,
    )[:, 1]  # fmt: skip
    about = np.array([0, 0, field[0]]) if size == 2 else field
    space = np.column_stack([v, np.zeros(len(v))])[:, :3]
    slope = np.gradient(space, times, axis=0, edge_order=2)
    assert np.allclose(np.linalg.norm(v, axis=1), np.linalg.norm(start[1]), atol=1e-9)
    assert np.allclose(slope[1:-1], np.cross(about, space)[1:-1], atol=5e-3)
