"""Bodies that pull each other, as strangers simulate them: no place between them does it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations import choice
from vidphys.diagnose.explanations.verdict import EXPLAINED, MOSTLY
from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.mechanisms.starts.orbits import orbiting
from vidphys.diagnose.recordings.balance import about_a_heavy_one
from vidphys.diagnose.telling.answered import Answered
from vidphys.diagnose.telling.answers import answer

STEP = 0.04


def pulled(masses, places, speeds, frames=300, soft=1e-2) -> np.ndarray:
    """Places ``(t, n, 2)`` of bodies under 1 / r², G = 1, by another's integrator."""
    m, n = np.array(masses), len(masses)

    def slope(_, y):
        q, v = y[: 2 * n].reshape(n, 2), y[2 * n :]
        apart = q[None] - q[:, None]
        cubed = ((apart**2).sum(-1) + soft**2) ** 1.5
        pull = (m[None, :, None] * apart / cubed[..., None]).sum(1)
        return np.concatenate([v, pull.ravel()])

    begin = np.concatenate([np.ravel(places), np.ravel(speeds)])
    times = np.arange(frames) * STEP
    found = solve_ivp(slope, (0, times[-1]), begin, t_eval=times, rtol=1e-9, atol=1e-9)
    return found.y[: 2 * n].T.reshape(frames, n, 2)


def told(places: np.ndarray) -> Answered:
    return answer(noisy(places, step=STEP), False, 0.3)


def test_two_that_circle_each_other_pull_each_other_though_a_place_between_them_would_do():
    given = told(pulled([1, 1], [(-0.5, 0), (0.5, 0)], [(0, -0.6), (0, 0.6)], soft=0.1))
    assert given.data["terms"] == ["pair"] and given.data["status"] == EXPLAINED
    assert any("attract each other; the force goes with 1 / r²" in line for line in given.lines)
    assert not any("Oscillation" in line for line in given.lines)  # they rest nowhere


@pytest.mark.slow
def test_the_pull_of_points_needs_no_length():
    given = told(pulled([1.5, 0.5], [(-0.25, 0), (0.75, 0)], [(0, -0.3), (0, 0.9)]))
    assert given.data["terms"] == ["pair"] and given.data["status"] == EXPLAINED
    assert any(line.endswith("the force goes with 1 / r²") for line in given.lines)
    assert any(line.startswith("Masses as 1 : 0.33") for line in given.lines)


def test_what_two_planets_go_round_is_told_though_it_was_not_followed():
    """A law of each by itself knows no power of a circle's pull; both together do (Kepler)."""
    around = [(0, 0), (1, 0), (-1.6, 0)], [(0, 0), (0, 1), (0, -0.75)]
    given = told(pulled([1, 0, 0], *around, soft=1e-3)[:, 1:])
    assert given.data["terms"] == ["centre"] and given.data["status"] == EXPLAINED
    power = given.data["mechanism"][0]["quantities"]["power of the distance"]
    assert power["value"] == pytest.approx(2, abs=3 * power["standard_error"])
    assert power["standard_error"] < 0.01


def test_a_sun_that_hardly_moves_pulls_its_planets_and_what_it_moves_tells_how_heavy_it_is():
    masses, places = [1, 1e-3, 3e-4], [(0, 0), (1, 0), (-1.8, 0)]
    path = pulled(masses, places, [(0, 0), (0, 1), (0, -0.72)], soft=1e-4)
    given = answer(noisy(path, 0.001, step=STEP), False, 0.3)
    assert given.data["terms"] == ["pair"] and given.data["status"] == EXPLAINED
    taken = given.specification["mass"]
    assert taken[1] / taken[0] == pytest.approx(1e-3, rel=0.2)
    (said,) = (line for line in given.lines if line.startswith("Times the mass of body 1"))
    value, _, error = said.partition("strength ")[2].split()[:3]
    assert abs(float(value) - 1) < float(error) < 0.01  # of the planets' masses, beside its own


@pytest.mark.parametrize(("wide", "taken"), [(0.9, True), (1.0, False)])
def test_only_bodies_that_come_nearer_and_go_farther_are_asked_for_a_heavy_one(wide, taken):
    turned = 3 * STEP * np.arange(300)
    round_it = np.stack([np.cos(turned), wide**2 * np.sin(turned)], -1)
    both = noisy(np.stack([np.zeros_like(round_it), round_it], 1), 0.001, step=STEP)
    assert (about_a_heavy_one(both) is not None) is taken


def test_a_place_between_two_bodies_pulls_neither():
    both = pulled([1, 1], [(-0.5, 0), (0.5, 0)], [(0, -0.6), (0, 0.6)])
    assert orbiting(frames_of(noisy(both, step=STEP)), False) == []


def test_of_bodies_that_keep_their_distance_it_is_not_told_how_the_force_falls_off():
    given = told(pulled([1, 1], [(-0.5, 0), (0.5, 0)], [(0, -(0.5**0.5)), (0, 0.5**0.5)]))
    assert given.data["terms"] == ["pair"] and given.data["status"] == MOSTLY
    (said,) = (line for line in given.lines if "as likely with" in line)
    assert "1 / r²" in said and "would tell" in said


@pytest.mark.slow
def test_molecules_repel_when_near_and_attract_farther_off():
    """As Lennard-Jones has it, in units of its own: sigma 2, epsilon 3."""

    def slope(_, y):
        apart = y[:2] - y[2:4]
        six = (2 / np.linalg.norm(apart)) ** 6
        push = 24 * 3 * (2 * six**2 - six) * apart / (apart @ apart)
        return [*y[4:], *push, *-push]

    times = np.arange(300) * 0.02
    start = [0, 0, 2.6, 0.2, 0.1, 0.2, -0.1, -0.2]
    found = solve_ivp(slope, (0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12)
    places = found.y[:4].T.reshape(-1, 2, 2)
    given = answer(noisy(places, 0.001, step=0.02), False, 0.3)
    assert given.data["terms"] == ["pair"] and given.data["status"] == EXPLAINED
    (said,) = (line for line in given.lines if "sigma" in line)
    _, sigma, _, epsilon, *_ = said.replace(",", "").split()
    assert float(sigma) == pytest.approx(2, rel=0.01)
    assert float(epsilon) == pytest.approx(3, rel=0.02)
    assert any(line.startswith("Oscillation") for line in given.lines)


def test_of_bodies_that_seem_struck_the_menu_is_asked_where_no_law_explains(monkeypatch):
    """Those that pass close by each other turn as if something unseen struck them."""
    monkeypatch.setattr(choice, "strikes", lambda _: [(0, 1.0)])
    monkeypatch.setattr(choice, "FITTED", (lambda *_: None,))
    both = pulled([1, 1], [(-0.5, 0), (0.5, 0)], [(0, -0.6), (0, 0.6)], soft=0.1)
    assert told(both).data["terms"] == ["pair"]
    alone = told(both[:, :1])  # a wall may have struck it, of which the menu knows nothing
    assert alone.data["terms"] == [] and "something strikes the body" in alone.data["refused"]
