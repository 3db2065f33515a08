"""Several bodies looked at over long windows: by one friction, or each by its own."""

import numpy as np
import pytest

from vidphys.diagnose.diagnosis import diagnose_motion
from vidphys.diagnose.inference.refine import refine
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.weak.paths import splined
from vidphys.diagnose.weak.windows import cut_windows

TIMES = np.arange(400) * 0.05
STIFFNESS = 4.0


def swinging(*rates: float) -> np.ndarray:
    """Bodies that a spring pulls to one place, ``(1, t, n, 2)``, with a rate of friction each."""
    bodies = []
    for number, rate in enumerate(rates):
        swing = np.sqrt(STIFFNESS - rate**2 / 4)
        fade = np.exp(-rate * TIMES / 2)
        turn = swing * TIMES + number
        bodies.append(np.stack([fade * np.cos(turn), 0.7 * fade * np.sin(turn + 0.4)], -1))
    noise = 0.002 * np.random.default_rng(0).standard_normal((len(TIMES), len(rates), 2))
    return (np.stack(bodies, 1) + noise)[None]


@pytest.mark.parametrize("rates", [(0.1, 0.1), pytest.param((0.09, 0.11), marks=pytest.mark.slow)])
def test_bodies_with_frictions_of_their_own_are_told_from_bodies_with_one(rates):
    look = diagnose_motion(motion_of(swinging(*rates), 0.05)).look
    assert look is not None
    friction = look.fitted.structure.term("friction")
    assert friction.apart == (rates[0] != rates[1])
    found = look.fitted.structure.of(friction)
    np.testing.assert_allclose(np.broadcast_to(found, 2), rates, rtol=0.05)


def test_fewer_nodes_than_frames_carry_a_smooth_path_and_give_the_same_numbers():
    motion = motion_of(swinging(0.1, 0.1), 0.05)
    found = diagnose_motion(motion)
    look = found.look
    frames = look.windows.frames.shape[1]
    assert frames == len(TIMES) and len(look.windows.nodes) < frames / 3
    whole = cut_windows(motion, frames)
    fitted = refine(whole, splined(whole, found.noise.sigma), look.fitted.structure)
    assert frames <= len(whole.nodes) < frames + whole.panels
    assert np.abs(fitted.values - look.fitted.values).max() < 1e-3 * fitted.errors.min()


@pytest.mark.parametrize("degree", [0, 3, 20])
def test_a_panel_needs_as_many_nodes_as_a_polynomial_has_numbers(degree):
    windows = cut_windows(motion_of(swinging(0.1), 0.05), 100)
    numbers = np.random.default_rng(1).uniform(1, 2, (degree + 1, 1))
    each = np.tile(windows.panel, windows.panels)
    path = np.polynomial.chebyshev.chebvander(each, degree) @ numbers
    a = np.broadcast_to(path[None, :, None], (len(windows), len(windows.nodes), 1, 2))
    assert windows.nodes_needed(a, 1e-9) == windows.panels * (degree + 1)
    assert windows.nodes_needed(a, 1e6) == 0


def test_panels_integrate_and_interpolate_as_one_would():
    motion = motion_of(swinging(0.1), 0.05)
    windows = cut_windows(motion, 400)
    assert windows.panels > 9
    x = windows.nodes
    assert (x[0], x[-1]) == (-1.0, 1.0)
    np.testing.assert_allclose(
        windows.once @ np.cos(9 * x), (np.sin(9 * x) + np.sin(9)) / 9, atol=1e-12
    )
    place = 2 * windows.times / windows.length[:, None] - 1
    np.testing.assert_allclose(windows.to_frames @ np.cos(9 * x), np.cos(9 * place), atol=1e-12)


def test_a_long_window_is_solved_panel_by_panel_as_by_one():
    """The closed form of a damped swing, over a window that lasts many panels."""
    motion = motion_of(swinging(0.1), 0.05)
    look = diagnose_motion(motion).look
    assert look is not None
    whole = cut_windows(motion, 400)
    fitted = refine(whole, splined(whole, 0.002), look.fitted.structure)
    stiffness, rate = fitted.structure.coefficients[0], fitted.structure.coefficients[-1]
    swing = np.sqrt(stiffness - rate**2 / 4)
    since = (whole.nodes + 1) * whole.length[0] / 2
    rest = fitted.structure.coefficients[1:3] / stiffness
    q, v = fitted.paths.q[0, :, 0] - rest, fitted.paths.v[0, 0, 0]
    second = (v + rate / 2 * q[0]) / swing
    fade = np.exp(-rate * since / 2)[:, None]
    turn = (swing * since)[:, None]
    closed = fade * (q[0] * np.cos(turn) + second * np.sin(turn))
    np.testing.assert_allclose(q, closed, atol=1e-8)
