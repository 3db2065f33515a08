"""Tables of simulations, without noise, by another's integrator: told as they are, and no more."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vidphys.diagnose.recordings.exact import FINEST, as_measured
from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.diagnose.telling.answers import answer


def rolled(slope, start, seconds, frames, shown) -> Motion:
    """The coordinates that are shown of a state, exact to 1e-12."""
    times = np.linspace(0, seconds, frames)
    method = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}
    path = solve_ivp(slope, (0, seconds), start, t_eval=times, **method).y[:shown].T
    return motion_of(path[None, :, None], times[1])


def drag(_t, y):
    speed = np.hypot(*y[2:])
    return [*y[2:], -0.1 * speed * y[2], -9.81 - 0.1 * speed * y[3]]


def orbit(_t, y):
    return [*y[2:], *(-y[:2] / np.hypot(*y[:2]) ** 3)]


def driven(t, y):
    return [y[1], -9 * y[0] - 0.3 * y[1] + 2 * np.cos(2.2 * t)]


SCENES = {
    "drag": (drag, [0, 0, 8, 9], 1.6, 160, 2, ["square", "uniform"]),
    "orbit": (orbit, [1, 0, 0, 0.8], 12, 400, 2, ["centre"]),
    "driven": (driven, [0.5, 0], 14, 500, 1, ["forcing", "linear", "trap"]),
}
NUMBERS = {  # what each law's numbers are
    "drag": {"square friction": 0.1, "acceleration": 9.81},
    "orbit": {"power of the distance": 2.0},
    "driven": {"rate": 3.0, "linear friction": 0.3, "rate of what drives it": 2.2}
    | {"strongest acceleration by what drives it": 2.0},
}


@pytest.mark.parametrize("name", SCENES)
def test_a_simulation_is_told_by_its_terms_and_no_others(name):
    *scene, terms = SCENES[name]
    given = answer(rolled(*scene), False, 0.3)
    assert given.data["terms"] == terms and given.data["status"] == "explained"
    told = given.data["mechanism"][0]["quantities"]
    for quantity, value in NUMBERS[name].items():
        assert told[quantity]["value"] == pytest.approx(value, rel=1e-5), quantity
    assert given.lines[-1].startswith("These places are exact")
    assert given.data["noise_added"] > 0


def test_the_pull_of_an_orbit_is_told_where_it_is_nearest():
    told = answer(rolled(*SCENES["orbit"][:-1]), False, 0.3).data["mechanism"][0]["quantities"]
    near = told["nearest distance"]["value"]
    pull = told["acceleration at the nearest distance"]["value"]
    assert pull * near**2 == pytest.approx(-1, rel=1e-4)  # of a force 1 / r²


@pytest.mark.slow
def test_a_simulated_cubic_spring_is_told_as_a_formula():
    motion = rolled(lambda _t, y: [y[1], -y[0] - 2 * y[0] ** 3], [1, 0], 12, 400, 1)
    given = answer(motion, False, 0.3)
    assert given.data["status"] == "explained"
    assert any(line.startswith("  x^3: times -2.000") for line in given.lines)


def test_only_what_is_finer_than_an_instrument_gets_noise():
    motion = rolled(orbit, [1, 0, 0, 0.8], 12, 400, 2)
    shaken, noise = as_measured(motion)
    assert noise == FINEST * motion.positions.std(1).max()
    assert np.std(shaken.positions - motion.positions) == pytest.approx(noise, rel=0.1)
    again, none = as_measured(shaken.take(np.array([0])))
    assert none in (0.0, noise)  # measured to some per cent
    rough = motion_of(motion.positions + np.random.default_rng(1).normal(size=(1, 400, 1, 2)), 0.03)
    assert as_measured(rough) == (rough, 0.0)


@pytest.mark.parametrize("slower", [1e5, 1e-5])
def test_a_pendulum_is_the_same_by_any_clock(slower):
    times = np.arange(300) * 0.02
    slope = lambda _t, y: [y[1], -19 * np.sin(y[0]) - 0.3 * y[1]]  # noqa: E731
    swing = solve_ivp(slope, (0, times[-1]), [1.2, 0], t_eval=times, rtol=1e-9).y[0]
    swing += 0.003 * np.random.default_rng(3).normal(size=swing.shape)
    one, other = (
        answer(motion_of(swing[None, :, None, None], 0.02 * factor), True, 0.3).data
        for factor in (1, slower)
    )
    assert one["terms"] == other["terms"] == ["linear", "pendulum"]
    rates = [x["mechanism"][0]["quantities"]["rate"]["value"] for x in (one, other)]
    assert rates[1] * slower == pytest.approx(rates[0], rel=1e-6)
