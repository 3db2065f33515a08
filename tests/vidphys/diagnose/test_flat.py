"""Motion in space that stays in a plane."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations.specification import read_specification
from vidphys.diagnose.explanations.verdict import EXPLAINED, NOT
from vidphys.diagnose.recordings.flat import in_its_plane
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer
from vidphys.runs.atomic import write_json

STEP = 0.04


def orbit(speed, frames=400) -> np.ndarray:
    """Places ``(t, d)`` of a planet about the origin under 1 / r², by another's integrator."""
    d = len(speed)

    def slope(_, y):
        return np.concatenate([y[d:], -y[:d] / np.linalg.norm(y[:d]) ** 3])

    times = np.arange(frames) * STEP
    start = np.concatenate([np.eye(d)[0], speed])
    return solve_ivp(slope, (0, times[-1]), start, t_eval=times, rtol=1e-10).y[:d].T


@pytest.mark.slow
def test_a_planet_whose_orbit_is_aslant_in_space_is_told_in_its_plane():
    given = answer(noisy(orbit([0, 0.7, 0.4]), 0.001), False, 0.3)
    assert given.data["terms"] == ["centre"] and given.data["status"] == EXPLAINED
    power = given.data["mechanism"][0]["quantities"]["power of the distance"]["value"]
    assert power == pytest.approx(2, abs=0.01)
    x, y = (np.array(given.data["plane"][axis]) for axis in "xy")
    assert np.cross(x, y) @ [0, -0.4, 0.7] / np.hypot(0.4, 0.7) == pytest.approx(1, abs=1e-3)
    assert given.lines[-1].startswith("The motion stays in a plane")


def test_a_pendulum_measured_in_space_is_no_stiff_spring():
    times = np.arange(120) / 30
    swing = 0.6 * np.exp(-0.05 * times) * np.cos(4 * times)
    path = np.stack([np.sin(swing), -np.cos(swing), np.zeros_like(swing)], 1)
    given = answer(noisy(path, 0.0025), False, 0.3)
    assert given.data["terms"] == ["linear", "pendulum"] and given.data["status"] != NOT
    assert given.data["plane"]["y"] == pytest.approx([0, 1, 0], abs=0.01)
    assert given.specification["plane"] == [given.data["plane"][axis] for axis in "xy"]


def test_a_nearly_round_orbit_is_no_pendulum_that_goes_over_the_top():
    given = answer(noisy(orbit([0, 1.03]), 0.001), False, 0.3)
    assert given.data["terms"] == ["centre"] and given.data["status"] == EXPLAINED


def test_riders_that_collide_on_a_track_in_space_are_told_along_it(tmp_path):
    times, hit = np.arange(180) * 0.002, 0.18
    since = np.maximum(times - hit, 0)
    along = np.stack([127 - 2 * times - 77 * since, 171 - 125 * times + 79 * since], 1)
    wobble = np.exp(-since / 0.05) * np.sin(150 * since) * (since > 0)
    path = along[..., None] * [0.995, 0.104, 0.0] + [0.0, 450.0, 398.0]
    path[..., 2] += 0.8 * wobble[:, None]
    noise = 0.03 * np.random.default_rng(2).normal(size=path.shape)
    given = answer(motion_of((path + noise)[None], 0.002), False, 0.3)
    assert given.data["terms"] == ["collision"] and given.data["status"] == EXPLAINED
    told = given.data["mechanism"][0]["quantities"]["mass ratio"]
    assert told["value"] == pytest.approx(77 / 79, abs=3 * told["standard_error"])
    (axis,) = given.specification["plane"]
    assert given.data["plane"] == {"x": axis} and axis == pytest.approx([0.995, 0.104, 0], abs=0.01)
    assert "on a line" in given.lines[-1]
    write_json(tmp_path / "specification.json", given.specification)
    assert read_specification(tmp_path / "specification.json")[1]["plane"] == [axis]


def test_what_leaves_every_plane_keeps_its_three_coordinates():
    times = np.linspace(0, 9, 300)
    helix = np.stack([np.cos(2 * times), np.sin(2 * times), 0.1 * times], 1)
    assert in_its_plane(noisy(helix)) is None
    line = times[:, None] * [1.0, 2.0, 3.0]
    assert in_its_plane(noisy(line)) is None
    assert in_its_plane(noisy(helix[:, :2])) is None


def test_up_stays_up_in_a_plane_that_stands():
    times = np.linspace(0, 1, 60)
    thrown = np.stack([3 * times, 4 * times, 5 * times - 4.9 * times**2], 1)
    flat, (x, y) = in_its_plane(noisy(thrown, 1e-6))
    assert np.allclose(y, [0, 0, 1], atol=1e-3) and abs(x @ [0.6, 0.8, 0]) > 0.999
    assert np.allclose(flat.positions[0, :, 0, 1], thrown[:, 2], atol=1e-2)
