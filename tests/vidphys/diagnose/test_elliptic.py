"""A body that two springs pull back, one harder than the other: both rates and axes are found."""

from __future__ import annotations

import numpy as np
import pytest

from tests.vidphys.diagnose.modelled import modelled
from vidphys.diagnose.mechanisms.choose import fits_of
from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.mechanisms.quantities import quantities
from vidphys.diagnose.mechanisms.starts.elliptic import elliptic
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer

STEP, FRAMES = 0.04, 220
CENTRE = np.array([3.0, -1.0])
FRICTION = 0.1


def swung(along, across, degrees, friction=FRICTION, frames=FRAMES):
    """Places of a body with these rates along an axis and across it, in closed form."""
    times, turn = np.arange(frames) * STEP, np.radians(degrees)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    fade = np.exp(-0.5 * friction * times)
    each = [
        size * fade * np.cos(np.sqrt(rate**2 - friction**2 / 4) * times + phase)
        for size, rate, phase in ((1.0, along, 0.4), (0.7, across, 1.9))
    ]
    return CENTRE + np.stack(each, -1) @ axes


def noisy(path, seed, noise=0.003):
    return path + noise * np.random.default_rng(seed).standard_normal(path.shape)


def clips(path, seed):
    return frames_of(motion_of(noisy(path, seed)[None, :, None], STEP))


@pytest.mark.parametrize(
    "along, across, degrees",
    [pytest.param(2.0, 3.1, 20.0, marks=pytest.mark.slow), (2.0, 2.4, -65.0)],
)
def test_both_rates_and_the_axes_are_found(along, across, degrees):
    best = fits_of(clips(swung(along, across, degrees), 51), angles=False)[0]
    assert best.kinds == {"trap", "linear"} and best.model.charts[0].name == "turned"
    known = {x.name: x for x in quantities(best)}
    truth = {
        "rate 1": along,
        "rate 2": across,
        "degrees from x to direction 1": degrees,
        "linear friction": FRICTION,
    }
    for name, value in truth.items():
        assert abs(known[name].value - value) < 3.5 * known[name].error < 0.1 * abs(value)


def test_without_friction_none_is_told():
    best = fits_of(clips(swung(2.0, 3.1, 20.0, friction=0.0), 52), angles=False)[0]
    assert best.kinds == {"trap"} and best.model.charts[0].name == "turned"


def test_one_rate_for_all_directions_needs_no_axes():
    best = fits_of(clips(swung(2.0, 2.0, 0.0), 53), angles=False)[0]
    assert best.model.charts[0].name == "plane" and best.kinds == {"trap", "linear"}


def test_a_body_on_an_arc_is_not_taken_for_two_springs():
    angles = 0.9 * np.cos(2.2 * np.arange(FRAMES) * STEP)
    arc = np.stack([np.sin(angles), -np.cos(angles)], -1)
    assert elliptic(clips(arc, 54)) == []
    assert fits_of(clips(arc, 54), angles=False)[0].model.charts[0].name == "arc"


def test_the_specification_goes_on_as_the_body_does():
    path = swung(2.0, 3.1, 20.0)
    given = answer(motion_of(noisy(path, 55)[None, :, None], STEP), False, 0.3)
    assert given.data["status"] == "explained"
    assert np.abs(modelled(given, path, STEP)[:150] - path[:150]).max() < 0.03
