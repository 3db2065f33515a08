"""The laws of the filmed scenes: their paths say the numbers that the truth states."""

import numpy as np
import pytest

from vidphys.experiments.filmed.laws.flights import BOUNCE, DRAG, ROLL, TOSS
from vidphys.experiments.filmed.laws.law import GRAVITY
from vidphys.experiments.filmed.laws.pendulums import (
    COUPLED_PENDULUMS,
    DOUBLE_PENDULUM,
    PENDULUM,
    TWO_PENDULUMS,
)
from vidphys.experiments.filmed.laws.pucks import PUCKS
from vidphys.experiments.filmed.laws.springs import SPRING, TWO_MASSES
from vidphys.experiments.filmed.scenes.kinds import KINDS, STRUCTURES
from vidphys.experiments.filmed.scenes.scene import course_of

TIMES = np.linspace(0, 4, 4001)
STEP = TIMES[1]


def path(law, *values):
    return law.path(np.array(values, float), TIMES)


def acceleration(places):
    return (places[2:] - 2 * places[1:-1] + places[:-2]) / STEP**2


def velocity(places):
    return (places[2:] - places[:-2]) / (2 * STEP)


def test_a_small_swing_has_the_period_of_its_length_and_loses_half_the_damping():
    length, damping = 0.6, 0.2
    x = path(PENDULUM, length, damping, 0.0, 0.01, 0.0)[:, 0, 0]
    half = damping / 2
    ringing = np.sqrt(GRAVITY / length - half**2)
    exact = (
        0.01
        * np.exp(-half * TIMES)
        * (np.cos(ringing * TIMES) + half / ringing * np.sin(ringing * TIMES))
    )
    assert np.abs(x / length - exact).max() < 2e-6


def test_a_large_swing_keeps_its_energy_and_its_length():
    length = 0.5
    places = path(PENDULUM, length, 0.0, 0.0, np.radians(80), 0.0)[:, 0]
    energy = 0.5 * (velocity(places) ** 2).sum(-1) + GRAVITY * places[1:-1, 1]
    assert np.ptp(energy) < 1e-3
    assert np.hypot(*places.T) == pytest.approx(length, rel=1e-12)


def test_drag_of_a_swing_is_of_its_speed_squared():
    length, drag = 0.5, 0.3
    places = path(PENDULUM, length, 0.0, drag, 1.0, 0.0)[:, 0]
    speed = np.sqrt((velocity(places) ** 2).sum(-1))
    energy = 0.5 * speed**2 + GRAVITY * places[1:-1, 1]
    spent = drag * (speed**3).cumsum() * STEP
    assert energy[0] - energy[-1] == pytest.approx(spent[-1], rel=1e-3)


def test_two_pendulums_do_not_know_of_each_other():
    one, two = (0.4, 0.1, 0.0, 0.3, 0.0), (0.7, 0.05, 0.0, -0.2, 0.0)
    both = path(TWO_PENDULUMS, *one, *two, 0.5, 0.1)
    assert both[:, :1] == pytest.approx(path(PENDULUM, *one))
    assert both[:, 1:] - [0.5, 0.1] == pytest.approx(path(PENDULUM, *two))


def test_small_coupled_swings_beat_at_the_modes_of_theory():
    length, stiffness = 0.5, 3.0
    places = path(COUPLED_PENDULUMS, length, 0.0, stiffness, 0.3, 0.004, 0.0)
    x = places[..., 0] - [0.0, 0.3]
    together, against = (x[:, 0] + x[:, 1]) / length, (x[:, 0] - x[:, 1]) / length
    omega = np.sqrt(GRAVITY / length)
    assert np.abs(together - 0.004 * np.cos(omega * TIMES)).max() < 1e-5
    faster = np.sqrt(omega**2 + 2 * stiffness)
    assert np.abs(against - 0.004 * np.cos(faster * TIMES)).max() < 1e-5


def test_a_double_pendulum_keeps_its_energy_with_its_masses():
    upper, lower, ratio = 0.3, 0.25, 0.7
    places = path(DOUBLE_PENDULUM, upper, lower, ratio, 0.9, -0.6)
    speed = (velocity(places) ** 2).sum(-1)
    energy = (0.5 * speed + GRAVITY * places[1:-1, :, 1]) @ [1, ratio]
    assert np.ptp(energy) < 1e-3
    assert np.hypot(*(places[:, 1] - places[:, 0]).T) == pytest.approx(lower, rel=1e-9)


def test_a_spring_pulls_back_with_its_own_rate():
    omega, damping = 6.0, 0.4
    x = path(SPRING, omega, damping, 1.0, 0.0, 0.1)[:, 0]
    left = acceleration(x) + damping * velocity(x) + omega**2 * x[1:-1]
    assert np.abs(left).max() < 1e-3
    assert x[0, 0] == pytest.approx(0.1)


def test_two_masses_pull_at_each_other_by_their_masses():
    first, between, second, ratio, damping, apart = 30.0, 12.0, 20.0, 1.6, 0.2, 0.3
    x = path(TWO_MASSES, first, between, second, ratio, damping, apart, 0.07, -0.02)[..., 0]
    off = x - [0, apart]
    pull = between * (off[:, 1] - off[:, 0])
    force = np.stack([pull - first * off[:, 0], (-pull - second * off[:, 1]) / ratio], 1)
    left = acceleration(off) + damping * velocity(off) - force[1:-1]
    assert np.abs(left).max() < 1e-3
    assert off[0] == pytest.approx([0.07, -0.02])


def test_a_bounce_keeps_its_restitution_and_rises_by_its_square():
    restitution, height = 0.8, 1.0
    y = path(BOUNCE, restitution, height, 0.2, 0.0)[:, 0, 1]
    fall = np.sqrt(2 * height / GRAVITY)
    for k in range(1, 4):
        begin = fall + 2 * fall * sum(restitution**j for j in range(1, k))
        inside = (begin < TIMES) & (begin + 2 * fall * restitution**k > TIMES)
        assert y[inside].max() == pytest.approx(height * restitution ** (2 * k), rel=1e-5)
    assert y.min() >= 0


def test_a_toss_falls_by_g_and_drag_ends_at_the_terminal_speed():
    assert acceleration(path(TOSS, 1.0, 4.0)[:, 0, 1]) == pytest.approx(-GRAVITY, rel=1e-3)
    drag = GRAVITY / 1.5**2
    assert velocity(path(DRAG, drag, 0.0, 0.0)[:, 0, 1])[-1] == pytest.approx(-1.5, rel=1e-4)


def test_a_rolling_ball_slows_and_stays():
    x = path(ROLL, -0.5, 1.0, 1.0, 0.0)[:, 0, 0]
    assert x[-1] == pytest.approx(1.0)
    assert acceleration(x)[:1900] == pytest.approx(-0.5, rel=1e-3)


def test_pucks_keep_their_momentum_and_lose_by_their_restitution():
    ratio, restitution, reach = 2.5, 0.8, 0.08
    start = (-0.3, 0.0, 0.2, 0.03, 0.4, 0.0, -0.1, 0.0)
    places = path(PUCKS, ratio, restitution, reach, *start)
    v = velocity(places)
    total = v[:, 0] + ratio * v[:, 1]
    smooth = np.abs(acceleration(places)).max((1, 2)) < 1e-3
    assert total[smooth] == pytest.approx(np.tile(total[0], (smooth.sum(), 1)), abs=1e-9)
    hit = int(np.argmin(smooth))
    between = places[hit, 1] - places[hit, 0]
    normal = between / np.hypot(*between)
    before, after = ((v[k, 1] - v[k, 0]) @ normal for k in (0, -1))
    assert -after / before == pytest.approx(restitution, rel=5e-3)
    assert np.hypot(*(places[:, 1] - places[:, 0]).T).min() > reach - 1e-3
    assert v[0, 0, 0] == pytest.approx(0.4)


def test_every_kind_of_scene_says_what_a_right_answer_is():
    assert set(KINDS) == set(STRUCTURES)


@pytest.mark.parametrize("kind", KINDS)
def test_every_scene_moves_all_its_bodies_and_states_numbers(kind):
    scene = KINDS[kind](np.random.default_rng(5))
    course = course_of(scene, 0.1)
    assert scene.kind == kind
    assert scene.numbers
    assert course.places.shape[1] == len(scene.looks)
    assert (np.ptp(course.places, 0).max(-1) > 0.02).all()
    jumps = np.abs(np.diff(course.places, axis=0)).max() * 9600
    assert jumps < 8  # m/s: a hand hands over without a jump


def test_a_ball_that_loses_nothing_bounces_for_as_long_as_it_is_asked_for():
    times = np.linspace(0.0, 3.0, 50)
    heights = BOUNCE.path(np.array([1.0, 0.5, 0.2, 0.0]), times)[:, 0, 1]
    assert heights.min() >= 0 and heights[-15:].max() > 0.45
