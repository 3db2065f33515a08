"""A double pendulum that goes over the top, by its weights' places."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from vidphys.diagnose.mechanisms.chain import linked
from vidphys.diagnose.mechanisms.rods import rods_in_picture
from vidphys.diagnose.recordings.motion import motion_of

STEP, FRAMES = 0.01, 160
LIGHT, SHORT = 0.3, 0.75  # the lower weight and rod, over the upper ones
G = 9.81


def falling(start: tuple[float, float]) -> np.ndarray:
    """Places ``(t, 2, 2)`` of weights on massless rods that are let go, by another's integrator."""

    def slope(_t, y):
        (a, b), (u, v) = y[:2], y[2:]
        c, s = np.cos(a - b), np.sin(a - b)
        mass = [[1 + LIGHT, LIGHT * SHORT * c], [c, SHORT]]
        force = [-LIGHT * SHORT * s * v**2 - (1 + LIGHT) * G * np.sin(a), s * u**2 - G * np.sin(b)]
        return [u, v, *np.linalg.solve(mass, force)]

    times = np.arange(FRAMES) * STEP
    a, b = solve_ivp(slope, (0, times[-1]), [*start, 0, 0], t_eval=times, rtol=1e-9).y[:2]
    upper = np.stack([np.sin(a), -np.cos(a)], -1)
    return np.stack([upper, upper + SHORT * np.stack([np.sin(b), -np.cos(b)], -1)], 1)


def test_rods_that_fall_from_above_their_pivot_are_told():
    places = falling((2.7, 3.1))
    assert places[:, 0, 1].mean() > 0  # the upper weight is above the pivot for most of the time
    noise = 0.004 * np.random.default_rng(1).normal(size=places.shape)
    found = rods_in_picture(motion_of((places + noise)[None], STEP), camera=False)
    assert found is not None and linked(found, angles=False)
    np.testing.assert_allclose(found.rods.lengths, [1.0, SHORT], rtol=0.01)
    assert abs(found.numbers["swing 1"][0] - G) < 0.03 * G


def test_rods_are_told_wherever_a_table_has_down():
    """Tables of pixels count downwards; of a picture it is known where up is."""
    places = falling((1.2, 0.7))
    places += 0.002 * np.random.default_rng(2).normal(size=places.shape)
    down = rods_in_picture(motion_of(places[None] * [1.0, -1.0], STEP), camera=False)
    assert down is not None and linked(down, angles=False)
    np.testing.assert_allclose(down.rods.lengths, [1.0, SHORT], rtol=0.01)
    assert abs(down.numbers["swing 1"][0] - G) < 0.03 * G
    up = rods_in_picture(motion_of(places[None], STEP), camera=False)
    assert abs(up.numbers["link"][0] - down.numbers["link"][0]) < down.numbers["link"][1]
    assert rods_in_picture(motion_of(places[None] * [1.0, -1.0], STEP), camera=True) is None


def test_a_weight_above_a_pivot_that_swings_little_hangs_from_none():
    """A body on an arc that is open upwards is on no rod that hangs."""
    swing = 0.3 * np.sin(4 * np.arange(FRAMES) * STEP)
    upper = np.stack([np.sin(swing), np.cos(swing)], -1)
    lower = upper + SHORT * np.stack([np.sin(2 * swing), np.cos(2 * swing)], -1)
    places = np.stack([upper, lower], 1) + 0.002 * np.random.default_rng(1).normal(
        size=(FRAMES, 2, 2)
    )
    assert rods_in_picture(motion_of(places[None], STEP), camera=True) is None
