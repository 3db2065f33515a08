"""A recording whose law ends with an impact: told of the part before, and that it ends there."""

import numpy as np
import pytest

from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer

STEP, PULL, FRAMES = 1 / 60, 9.8, 150


def bouncing(kick, when, restitution=0.75):
    """A ball that bounces off a floor, ``(t, 1, 2)``, whose velocity a kick changes at a frame."""
    out, x, v = [], np.array([0.0, 1.0]), np.array([0.8, 0.0])
    fine = 20
    for k in range(FRAMES * fine):
        if k % fine == 0:
            out.append(x.copy())
        if k == when * fine + fine // 2:
            v = v + kick
        v[1] -= PULL * STEP / fine
        x = x + v * STEP / fine
        if x[1] < 0 and v[1] < 0:
            v[1] *= -restitution
    noise = 0.002 * np.random.default_rng(7).standard_normal((FRAMES, 2))
    return motion_of((np.array(out) + noise)[None, :, None], STEP)


@pytest.mark.parametrize("kick, struck", [((0.9, 1.5), True), ((0.0, 0.0), False)])
def test_a_law_is_told_up_to_an_impact_that_it_has_not(kick, struck):
    given = answer(bouncing(np.array(kick), 112), False, 0.3)
    assert given.data["terms"] == ["uniform", "wall"]
    assert given.data["status"] == ("mostly explained" if struck else "explained")
    last = given.data["frames"]["last"]
    assert 110 <= last <= 114 if struck else last == FRAMES - 1
    assert (
        given.lines[0].endswith(f"after {last} comes an impact that the law does not foretell.")
        is struck
    )
    found = given.data["mechanism"][0]["quantities"]
    assert abs(found["restitution"]["value"] - 0.75) < 0.02
    assert abs(found["acceleration"]["value"] - PULL) < 0.3


@pytest.mark.slow
def test_what_is_followed_after_a_long_gap_may_be_something_else():
    """A ball that leaves the picture; then somebody's sleeve takes its place."""
    rng, times = np.random.default_rng(3), np.arange(60) * STEP
    flown = np.stack([0.8 * times, 1.2 * times - PULL / 2 * times**2], -1)
    sleeve = np.array([-0.6, -0.9]) + np.cumsum(0.01 * rng.standard_normal((50, 2)), 0)
    path = np.concatenate([flown, np.full((15, 2), np.nan), sleeve])
    given = answer(
        motion_of((path + 0.002 * rng.standard_normal(path.shape))[None, :, None], STEP), False, 0.3
    )
    assert given.data["terms"] == ["uniform"] and given.data["status"] == "mostly explained"
    assert given.data["frames"]["last"] == 59
    assert "after 59 comes a gap of 15 frames" in given.lines[0]
