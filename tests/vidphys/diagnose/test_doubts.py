"""What leaves a law in doubt though no other is as likely."""

from dataclasses import replace

import numpy as np
import pytest

from vidphys.diagnose.explanations.doubts import (
    CIRCLES,
    MISSED,
    SETTLES,
    STRUCK,
    UNTOLD,
    doubts,
)
from vidphys.diagnose.explanations.law_words import SCALED, number
from vidphys.diagnose.explanations.rivals import rivals, undecided
from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.bodies.lawful import of_lawful_bodies
from vidphys.diagnose.mechanisms.mechanism import find_mechanism
from vidphys.diagnose.mechanisms.quantities import quantities
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.units import Units

STEP = 1 / 30


def noisy(places):
    noise = np.random.default_rng(0).normal(0, 5e-4, places.shape)
    return motion_of((places + noise)[None], STEP)


def drawn(rate, friction, frames=60):
    """Places ``(t, 1, 2)`` of what a spring draws to its place, on a line aslant."""
    times = np.arange(frames) * STEP
    root = np.sqrt(complex(friction**2 / 4 - rate**2))
    way = np.exp(-friction * times / 2) * (
        np.cosh(root * times) + friction / 2 / root * np.sinh(root * times)
    )
    return (way.real[:, None] * [0.3, 0.1] + [0.1, -0.2])[:, None]


@pytest.mark.parametrize(
    ("friction", "settled"),
    [(2.0, False), (9.0, True), pytest.param(20.0, True, marks=pytest.mark.slow)],
)
def test_what_comes_to_rest_without_a_swing_may_be_a_hand(friction, settled):
    found = find_mechanism(noisy(drawn(8.0, friction)), camera=True)
    fit = found.groups[0].fit
    assert fit.settles is settled and (SETTLES in doubts(fit)) is settled
    assert not settled or (undecided(found) and SETTLES in rivals(found))


def test_a_thrown_ball_is_the_body_and_not_the_hand_that_settles():
    times = np.arange(60) * STEP
    held, free = np.minimum(times, 0.8)[:, None], np.maximum(times - 0.8, 0)[:, None]
    ball = [0.2, -0.3] + free * [-0.5, 2.4] - free**2 * [0.0, 2.1]
    ball += 0.08 * held**2 * np.sin(9 * held)
    hand = np.full((60, 2), np.nan)
    hand[20:] = [0.25, -0.35] + drawn(16.0, 36.0, 40)[:, 0]
    looked_at, said = of_lawful_bodies(noisy(np.stack([hand, ball], 1)))
    assert looked_at.bodies == 1 and len(said) == 1
    np.testing.assert_allclose(looked_at.positions[0, -20:, 0], ball[-20:], atol=3e-3)


def test_a_law_that_has_too_little_of_its_motion_or_no_number_for_its_force_is_in_doubt():
    fit = find_mechanism(noisy(drawn(8.0, 1.0)), camera=True).groups[0].fit
    assert not {MISSED, UNTOLD} & {*doubts(fit)}
    worse = replace(fit, residuals=tuple(r + 0.2 * fit.spread for r in fit.residuals))
    assert MISSED in doubts(worse)
    assert UNTOLD in doubts(replace(fit, covariance=1e8 * fit.covariance))


def test_a_force_is_told_though_a_plane_aslant_shows_lengths_unevenly():
    times = np.linspace(0, 1.6, 60)[:, None]
    tossed = [-0.7, -0.3] + times * [0.9, -1.4] + times**2 * [0.0, 0.9]
    aslant = view.seen(tossed, np.array([0.3, 0.0, 0.0]))[:, None]
    fit = find_mechanism(noisy(aslant), camera=True).groups[0].fit
    assert fit.kinds == {"uniform"} and UNTOLD not in doubts(fit)
    anywhere, beside = (
        next(x for x in quantities(fit, ruler) if x.name == "acceleration")
        for ruler in (None, ((-0.3, -0.6), (0.3, -0.6)))
    )
    assert anywhere.measured and not anywhere.known and SCALED in number(anywhere, Units())
    assert beside.known and beside.scale < 0.2 * anywhere.scale


@pytest.mark.parametrize(("wide", "round_"), [(1.0, True), (0.8, False)])
def test_a_circle_does_not_tell_what_pulls_to_its_middle(wide, round_):
    turned = 3 * np.arange(150) * STEP
    way = 0.4 * np.stack([np.cos(turned), wide * np.sin(turned)], -1)[:, None]
    found = find_mechanism(noisy(way))
    assert found.groups[0].fit.kinds == {"trap"}
    assert (CIRCLES in doubts(found.groups[0].fit)) is round_


@pytest.mark.parametrize("camera", [True, False])
def test_what_turns_round_once_may_have_been_struck_by_a_body_that_was_not_followed(camera):
    times, met = np.arange(110) * STEP, 2.03  # seconds, between two frames
    across = np.where(times < met, 0.3 * times, 0.3 * met - 0.17 * (times - met))
    path = np.stack([across - 0.3, 0.1 * times - 0.2], 1)
    fit = find_mechanism(noisy(path[:, None]), camera=camera).groups[0].fit
    assert fit.kinds == {"wall"} and (STRUCK in doubts(fit)) is camera


def test_a_doubt_names_its_body_where_others_have_laws_of_their_own():
    turned = 3 * np.arange(150) * STEP
    circle = np.stack([np.cos(turned), np.sin(turned)], -1)
    ellipse = np.stack([np.sin(1.3 * turned), 0.6 * np.cos(1.3 * turned)], -1)
    both = find_mechanism(noisy(np.stack([ellipse, 0.4 * circle], 1)))
    (named,) = (x for x in rivals(both) if "on a circle" in x)
    assert named == CIRCLES.replace("In doubt:", "In doubt, body 2:")
    assert CIRCLES in rivals(find_mechanism(noisy(0.4 * circle[:, None])))
