"""Balls that spin: what a wall takes from their speed along it comes back at the next bounce."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vidphys.diagnose.explanations.mechanism import ByMechanism
from vidphys.diagnose.mechanisms.kernels.motion import rolled
from vidphys.diagnose.mechanisms.kernels.walls import SOLID
from vidphys.diagnose.mechanisms.mechanism import find_mechanism
from vidphys.diagnose.mechanisms.quantities import quantities
from vidphys.diagnose.mechanisms.sense import makes_sense
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.units import Units

STEP, PULL = 1 / 60, 9.8
GRIP = "tangential restitution"


def gripped(grip, spin=0.0, restitution=0.8, height=1.2, speed=1.1, frames=150):
    """Places of a solid ball above a floor, flight by flight in closed form."""
    times, out = np.arange(frames) * STEP, np.zeros((frames, 2))
    begin, x, y, v, up = 0.0, 0.1, height, speed, 0.0
    while begin < times[-1]:
        lasts = (up + np.sqrt(up**2 + 2 * PULL * y)) / PULL
        now = (times >= begin - 1e-12) & (times < begin + lasts)
        since = times[now] - begin
        out[now] = np.stack([x + v * since, y + up * since - PULL * since**2 / 2], -1)
        begin, x, y, up = begin + lasts, x + v * lasts, 0.0, restitution * (PULL * lasts - up)
        impulse = (1 + grip) * (v - spin) / (1 + 1 / SOLID)  # of its mass; the floor is below
        v, spin = v - impulse, spin + impulse / SOLID
    return out


def filmed(places, noise=0.003, seed=0):
    noisy = places + noise * np.random.default_rng(seed).standard_normal(places.shape)
    return motion_of(noisy[None, :, None], STEP)


def told(motion):
    return {x.name: x for x in quantities(find_mechanism(motion).groups[0].fit)}


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_ball_that_grips_changes_its_speed_as_a_solid_ball_does(way):
    path = gripped(0.7, spin=0.4) * [way, 1.0]
    times, floor = np.arange(len(path)) * STEP, np.array([[0.0, -1.0, 0.0, 0.8, 0.7]])
    start, still = np.array([path[0], [way * 1.1, 0.0]]), np.zeros(3)
    # The slip at a floor below is v.t + w, with t to the right: a ball that rolls there has w = -v.
    out = rolled(
        times, start, np.array([0, -PULL]), np.zeros((2, 2)), np.zeros(2), still, floor, 1e-3,
        spin=-way * 0.4,
    )  # fmt: skip
    np.testing.assert_allclose(out[:, 0], path, atol=1e-5)


@pytest.mark.parametrize("grip, seed", [(0.75, 31), pytest.param(0.3, 32, marks=pytest.mark.slow)])
def test_the_tangential_restitution_is_told_where_two_bounces_show_it(grip, seed):
    numbers = told(filmed(gripped(grip, spin=0.2), seed=seed))
    assert abs(numbers[GRIP].value - grip) < 3 * numbers[GRIP].error < 0.2
    assert numbers["restitution"].value == pytest.approx(0.8, abs=0.01)


@pytest.mark.slow
def test_a_grip_that_no_bounce_tells_of_is_not_believed():
    found = find_mechanism(filmed(gripped(0.75, spin=0.2), seed=31)).groups[0].fit
    (_, error) = found.numbers["grip 1"]
    assert makes_sense(found)
    assert not makes_sense(replace(found, covariance=(0.6 / error) ** 2 * found.covariance))


def test_a_spin_that_only_a_bounce_held_out_shows_is_told_but_foretells_nothing():
    motion, end = filmed(gripped(0.8, frames=105), seed=33), 58  # between the two bounces
    law = ByMechanism.of(motion, end, False, False, Units())
    assert GRIP in law.data()["mechanism"][0]["quantities"]
    assert law.verdict.status == "mostly explained"
    other = motion.positions.copy()
    other[:, end:] = other[:, end - 1 : end]
    blind = ByMechanism.of(replace(motion, positions=other), end, False, False, Units())
    foretold = [each.rolled_on().forecasts["model"] for each in (law, blind)]
    np.testing.assert_array_equal(*foretold)


@pytest.mark.parametrize("kept, seed", [(1.0, 34), (0.8, 35)])
def test_a_body_whose_speed_along_a_wall_keeps_a_share_does_not_spin(kept, seed):
    times, floor = np.arange(150) * STEP, np.array([[0.0, -1.0, 0.0, 0.8, kept]])
    start = np.array([[0.1, 1.2], [1.1, 0.0]])
    none = np.zeros(2)
    pull, swing, friction = np.array([0, -PULL]), np.zeros((2, 2)), np.zeros(3)
    path = rolled(times, start, pull, swing, none, friction, floor, 1e-3)[:, 0]
    assert GRIP not in told(filmed(path, seed=seed))
