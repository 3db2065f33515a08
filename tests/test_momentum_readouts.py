"""Differencing and shooting on the true law, where the answer is known."""

from dataclasses import replace

import pytest
import torch
from torch import Generator

from binders import Tracks
from dynamics import PhaseState
from readouts.differencing import backward_difference, central_difference
from readouts.shooting import shoot
from vidphys.initial_state import FADES, by_differencing, by_shooting, choose_fade, frame_roll
from vidphys.scenes import gravity

INTERVAL, STRIDE, FRAMES = 0.08, 40, 7
SCENE = gravity(mass=(1.0, 1.0))


def window(episodes: int = 12, noise: float = 0.0):
    rng = Generator().manual_seed(4)
    start, params = SCENE.sample(episodes, rng)
    truth = SCENE.simulate(start, params, STRIDE * (FRAMES - 1), STRIDE)
    q = truth.states.q + noise * torch.randn(truth.states.q.shape, generator=rng).double()
    times = torch.arange(FRAMES, dtype=torch.float64) * INTERVAL
    return truth, Tracks(q, torch.ones(q.shape[:-1], dtype=torch.float64), times), params


def error(state: PhaseState, truth) -> torch.Tensor:
    return (state.p - truth.states.p[:, -1]).norm(dim=-1).amax(-1)


def test_differences_are_exact_on_parabolas():
    t = torch.arange(5, dtype=torch.float64)[None, :, None, None] * 0.5
    q = (1 + 2 * t - 3 * t**2).expand(1, 5, 1, 2)
    mass = torch.full((1, 1), 2.0, dtype=torch.float64)
    speed = 2 - 6 * t
    last = backward_difference(q, mass, 0.5)
    torch.testing.assert_close(last.p, 2 * speed[:, -1].expand(1, 1, 2))
    inner = central_difference(q, mass, 0.5)
    torch.testing.assert_close(inner.p, 2 * speed[:, 1:-1].expand(1, 3, 1, 2))
    torch.testing.assert_close(inner.q, q[:, 1:-1])


def test_a_reversed_clip_has_the_opposite_momentum():
    _, tracks, params = window()
    forward = central_difference(tracks.positions, params.mass, INTERVAL)
    backward = central_difference(tracks.positions.flip(1), params.mass, INTERVAL)
    torch.testing.assert_close(backward.p.flip(1), -forward.p)


@pytest.mark.parametrize("frames", [1, 2])
def test_too_few_frames_are_refused(frames):
    q = torch.zeros(1, frames, 2, 2)
    roll = frame_roll(SCENE.law, SCENE.sample(1, Generator())[1], INTERVAL)
    for call in (
        lambda: backward_difference(q, torch.ones(1, 2), INTERVAL),
        lambda: central_difference(q, torch.ones(1, 2), INTERVAL),
        lambda: shoot(roll, q, PhaseState(q[:, 0], q[:, 0])),
    ):
        with pytest.raises(ValueError, match=f"got {frames}"):
            call()


def test_shooting_finds_the_start_that_explains_the_window():
    truth, tracks, params = window()
    roll = frame_roll(SCENE.law, params, INTERVAL)
    q = tracks.positions
    guess = PhaseState(q[:, 0], truth.states.p[:, 0] + 0.2)
    fit = shoot(roll, q, guess, rounds=8)
    # The law is rolled at 0.01 s here and 0.002 s in truth; encounters see the difference.
    assert fit.improved.all()
    assert error(fit.states[:, -1], truth).median() < 1e-3
    assert fit.rmse.median() < 1e-4


def test_shooting_beats_differencing_on_noise_and_on_truncation():
    for noise in (0.0, 0.005):
        truth, tracks, params = window(episodes=24, noise=noise)
        plain = error(by_differencing(SCENE.law, tracks, params, INTERVAL), truth).median()
        fitted = error(by_shooting(SCENE.law, tracks, params, INTERVAL), truth).median()
        assert fitted < 0.35 * plain


def test_an_unexplained_window_is_shortened_not_trusted():
    truth, tracks, params = window(episodes=24)
    broken = tracks.positions.clone()
    broken[3, 0] += 1.5  # one wild first frame in one episode
    state = by_shooting(
        SCENE.law, Tracks(broken, tracks.confidence, tracks.times), params, INTERVAL
    )
    clean = by_shooting(SCENE.law, tracks, params, INTERVAL)
    assert error(state, truth)[3] < 0.1
    others = torch.arange(24) != 3
    torch.testing.assert_close(state.q[others], clean.q[others], atol=1e-3, rtol=0)


def test_shooting_refuses_what_is_not_finite():
    _, tracks, params = window()
    q = tracks.positions.clone()
    q[0, 0, 0, 0] = float("nan")
    roll = frame_roll(SCENE.law, params, INTERVAL)
    with pytest.raises(ValueError, match="finite"):
        shoot(roll, q, PhaseState(q[:, 0], q[:, 0]))


def test_old_frames_count_where_positions_err_and_not_where_the_law_does():
    _, noisy, params = window(episodes=24, noise=0.01)
    assert choose_fade(SCENE.law, noisy, params, INTERVAL) == max(FADES)
    _, exact, params = window(episodes=24)
    wrong = replace(params, coupling=0.5 * params.coupling)
    assert choose_fade(SCENE.law, exact, wrong, INTERVAL) == min(FADES)
