"""A drag of which the fitted frames alone do not tell, and all frames do."""

from __future__ import annotations

import numpy as np
import pytest

from vidphys.diagnose.explanations.verdict import EXPLAINED, MOSTLY
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer

STEP, FRAMES, G = 1 / 60, 27, 9.81


def dropped(limit: float, seed: int = 3):
    """A ball that falls towards a speed at which the air holds it, ``inf``: without air."""
    times = np.arange(FRAMES) * STEP + 0.07
    if np.isinf(limit):
        fallen = 0.5 * G * times**2
    else:
        fallen = limit**2 / G * np.log(np.cosh(G * times / limit))
    noise = 7e-4 * np.random.default_rng(seed).normal(size=(1, FRAMES, 1, 1))
    return motion_of(noise - fallen[None, :, None, None], STEP)


def test_all_frames_tell_of_a_drag_that_few_do_not():
    given = answer(dropped(9.0), False, 0.3)
    assert given.data["terms"] == ["square", "uniform"] and given.data["status"] == MOSTLY
    pull = given.data["mechanism"][0]["quantities"]["acceleration"]
    assert abs(pull["value"] - G) < 2 * pull["standard_error"] < 0.1 * G
    assert any("All frames choose this law" in line for line in given.lines)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_fall_without_a_drag_is_told_without_one(seed):
    given = answer(dropped(np.inf, seed), False, 0.3)
    assert given.data["terms"] == ["uniform"] and given.data["status"] == EXPLAINED


@pytest.mark.parametrize("seed", [1, 3])
def test_a_blow_in_the_first_frames_is_no_friction(seed):
    """What goes straight on after it had been told as braked to a steady speed at once."""
    times = np.arange(70) * STEP
    early, late = np.minimum(times, 4.4 * STEP), np.maximum(times - 4.4 * STEP, 0.0)
    places = np.stack([180 * early + 45 * late, -78 * late], -1)
    noise = 0.3 * np.random.default_rng(seed).normal(size=places.shape)
    given = answer(motion_of((places + noise)[None, :, None], STEP), False, 0.3)
    assert given.data["status"] != EXPLAINED or given.data["terms"] == []
