"""Bodies that keep to a curve: on ramps, in bowls, over hills and through loops."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.modelled import modelled
from tests.vidphys.diagnose.test_mechanisms import noisy, swing
from vidphys.diagnose.explanations import doubts
from vidphys.diagnose.explanations.verdict import EXPLAINED, MOSTLY
from vidphys.diagnose.mechanisms.curve import curve_through
from vidphys.diagnose.mechanisms.kernels.sliding import slid
from vidphys.diagnose.telling.answered import Answered
from vidphys.diagnose.telling.answers import answer

G, ROLLS = 9.81, 5 / 7  # of a solid ball, what rolling leaves of the pull
NOISE = 0.001


def moved(height, slope, bend, start, seconds, frames, pull=G, linear=0.0, rubs=0.0):
    """Places ``(t, 1, 2)`` of what slides on ``y = height(x)``, by another's integrator."""

    def push(_, y):
        x, rate = y
        up = slope(x)
        long = np.hypot(1, up)
        speed = long * rate
        pressed = abs(bend(x) / long**3 * speed**2 + pull / long)
        along = -pull * up / long - linear * speed - rubs * pressed * np.tanh(speed / 1e-4)
        return [rate, (along - up * bend(x) / long * rate**2) / long]

    times = np.linspace(0, seconds, frames)
    x = solve_ivp(push, (0, seconds), start, t_eval=times, rtol=1e-9, atol=1e-11).y[0]
    return np.stack([x, height(x)], -1)[:, None], times[1]


def told(places: np.ndarray, step: float) -> Answered:
    return answer(noisy(places, NOISE, step), False, 0.3)


def quantity(given: Answered, name: str) -> tuple[float, float]:
    known = given.data["mechanism"][0]["quantities"][name]
    return known["value"], known["standard_error"]


def inside(given: Answered, name: str, true: float) -> bool:
    value, error = quantity(given, name)
    return abs(value - true) < 3 * error and error < 0.05 * true


def test_what_slides_to_and_fro_in_a_bowl():
    bowl = (np.poly1d([1.2, 0, 0]).deriv(n) for n in range(3))
    places, step = moved(*bowl, [-0.6, 0.0], 4.0, 120, linear=0.15)
    given = told(places, step)
    assert given.data["terms"] == ["curve", "linear", "uniform"]
    assert given.data["status"] in (EXPLAINED, MOSTLY)
    assert inside(given, "acceleration", G) and inside(given, "linear friction", 0.15)
    off = np.linalg.norm(modelled(given, places[:, 0], step) - places[:, 0], axis=1)
    assert off.max() < 0.03  # of a way of 1.3 there and back


def test_a_ball_that_rolls_down_a_ramp_whose_end_nothing_was_fitted_to():
    given = told(
        *moved(
            lambda x: 0.5 * np.exp(-2 * x),
            lambda x: -np.exp(-2 * x),
            lambda x: 2 * np.exp(-2 * x),
            [0.0, 0.1],
            1.2,
            60,
            pull=ROLLS * G,
        )
    )
    assert given.data["terms"] == ["curve", "uniform"] and given.data["status"] == MOSTLY
    assert inside(given, "acceleration", ROLLS * G) and doubts.ONCE in given.lines


def test_dry_friction_goes_with_what_presses_it_to_the_curve():
    ramp = (lambda x, n=n: 0.8 * (-2.0) ** n * np.exp(-2 * x) for n in range(3))
    places, step = moved(*ramp, [0.0, 0.1], 1.2, 60, rubs=0.15)
    given = told(places, step)
    assert given.data["terms"] == ["curve", "dry", "uniform"]
    assert given.data["status"] in (EXPLAINED, MOSTLY)
    assert inside(given, "friction coefficient", 0.15) and inside(given, "acceleration", G)
    assert np.abs(modelled(given, places[:, 0], step) - places[:, 0]).max() < 0.01


def test_a_path_that_crosses_itself_is_read_in_order():
    """A loop: on the way out the body is where it was on the way in."""
    u = np.linspace(-1.5, 8.0, 400)
    path = np.stack([u - 1.8 * np.sin(u), 1.8 * np.cos(u)], -1)
    curve = curve_through([path])
    assert curve is not None
    s = curve.read(path)
    assert (np.diff(s) > 0).all()
    assert np.abs(curve.at(s) - path).max() < 0.02
    chords = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert curve.length == pytest.approx(chords.sum(), rel=1e-3)


def test_what_friction_holds_stays():
    """On a slope whose tangent is below the coefficient it comes to rest, above it never."""
    down = np.tile([np.cos(-0.3), np.sin(-0.3), 0.0], (10, 1))
    times, force = np.linspace(0, 3, 50), np.array([0.0, -G])
    for coefficient, rests in ((0.35, True), (0.25, False)):
        friction = np.array([0.0, 0.0, coefficient])
        out = slid(times, np.array([[0.0], [0.5]]), force, friction, down, 0.5, 0.01)
        assert (out[-1, 1, 0] == 0) == rests
        assert rests == (out[-1, 0, 0] == out[-2, 0, 0])


def test_energy_is_kept_without_friction():
    x = np.linspace(-1, 1, 400)
    curve = curve_through([np.stack([x, x**4 - x**2], -1)])
    assert curve is not None
    start, force = np.array([[0.1], [0.0]]), np.array([0.0, -G])
    times = np.linspace(0, 20, 400)
    out = slid(times, start, force, np.zeros(3), curve.table, curve.spacing, 5e-3)
    energy = 0.5 * out[:, 1, 0] ** 2 + G * curve.at(out[:, 0, 0])[:, 1]
    assert np.ptp(energy) < 2e-3 * G * 0.25


def test_a_pendulum_whose_arc_is_seen_bent_is_told_as_one():
    """As a tracker errs by the place; a curve that all places draw would follow that."""
    angle = swing(G, 0.1, 0.7, 200, step=0.04)
    places = np.stack([np.sin(angle), 0.3 - np.cos(angle)], -1)
    wave = np.stack([np.sin(3 * places[:, 0]), np.cos(20 * places[:, 0])], -1)
    given = told((places + 0.01 * wave)[:, None], 0.04)
    assert given.data["terms"] == ["linear", "pendulum"]
    assert quantity(given, "rate")[0] == pytest.approx(np.sqrt(G), rel=0.02)


def test_places_at_both_ends_alone_draw_no_curve():
    """Nothing is seen where a part of the spline is."""
    ends = np.concatenate([np.linspace(0, 0.002, 20), [0.94, 0.96, 0.98, 1.0]])
    assert curve_through([np.stack([ends, ends**2], -1)]) is None
