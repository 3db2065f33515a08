"""Differencing and shooting on the true law, where the answer is known."""

from dataclasses import replace

import pytest
import torch
from torch import Generator

from binders import Tracks
from dynamics import Hamiltonian, PhaseState
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import NoPotential
from readouts.differencing import backward_difference, central_difference
from readouts.smoothing import SmoothingSettings, smooth
from vidphys.scenes import gravity
from vidphys.shooting.encounters import sought
from vidphys.shooting.initial_state import (
    ShootingSettings,
    by_differencing,
    by_shooting,
    choose_slack,
    frame_step,
)

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
    for call in (
        lambda: backward_difference(q, torch.ones(1, 2), INTERVAL),
        lambda: central_difference(q, torch.ones(1, 2), INTERVAL),
    ):
        with pytest.raises(ValueError, match=f"got {frames}"):
            call()


def test_shooting_beats_differencing_on_noise_and_on_truncation():
    for noise in (0.0, 0.005):
        truth, tracks, params = window(episodes=24, noise=noise)
        plain = error(by_differencing(SCENE.law, tracks, params, INTERVAL), truth).median()
        fitted = error(by_shooting(SCENE.law, tracks, params, INTERVAL), truth).median()
        assert fitted < 0.35 * plain


def smoothed(q, guess: PhaseState, params, slacks=(0.1, 0.01, 0.001), expected=0.002, **more):
    step = frame_step(SCENE.law, params, INTERVAL)
    error = torch.full(q.shape[:-1], expected, dtype=torch.float64)
    settings = SmoothingSettings(**more)
    return list(smooth(step, q, error, guess, INTERVAL, slacks, settings))


def defect(states: PhaseState, params) -> torch.Tensor:
    """How far each state's momenta are from where the law carries the one before."""
    step, everyone = frame_step(SCENE.law, params, INTERVAL), torch.arange(len(states.q))
    later = [step(states[:, t], everyone).p for t in range(6)]
    return (torch.stack(later, 1) - states.p[:, 1:]).flatten(1).abs().amax(1)


def test_states_become_one_rollout_as_the_slack_is_drawn_in():
    truth, tracks, params = window(noise=0.002)
    wrong = PhaseState(tracks.positions, torch.zeros_like(tracks.positions))
    loose, middle, tight = (fit.states for fit in smoothed(tracks.positions, wrong, params))
    assert defect(tight, params).median() < 0.1 * defect(loose, params).median()
    assert error(tight[:, -1], truth).median() < 0.7 * error(loose[:, -1], truth).median()


@pytest.mark.parametrize("frames", [3, 4, FRAMES])
def test_smoothed_states_cost_what_the_noise_does_however_long_the_window(frames):
    """Two frames cost nothing, whatever they show: a short window is not the better for it."""
    truth, tracks, params = window(episodes=48, noise=0.002)
    positions = tracks.positions[:, -frames:]
    guess = PhaseState(positions, truth.states.p[:, -frames:])
    cost = smoothed(positions, guess, params)[-1].cost.mean()
    free = 2 * SCENE.bodies
    assert 0.7 * free < cost < 1.1 * free


def test_a_position_that_nothing_explains_is_let_go():
    truth, tracks, params = window(episodes=24, noise=0.002)
    lost = tracks.positions.clone()
    lost[3, 6, 1] += 0.7  # the last frame of one body, where a rollout would start
    guess = PhaseState(lost, truth.states.p)
    found = smoothed(lost, guess, params)[-1].states
    assert (found.q[3, -1] - truth.states.q[3, -1]).abs().max() < 0.02


def test_episodes_are_smoothed_each_by_itself():
    _, tracks, params = window(noise=0.002)
    guess = PhaseState(tracks.positions, torch.zeros_like(tracks.positions))
    alone = smoothed(tracks.positions[4:6], guess[4:6], params[4:6])[-1]
    both = smoothed(tracks.positions, guess, params)[-1]
    torch.testing.assert_close(alone.states.p, both.states.p[4:6], atol=1e-6, rtol=0)


@pytest.mark.parametrize(("frames", "value"), [(2, 0.0), (7, float("nan"))])
def test_smoothing_refuses_what_says_nothing(frames, value):
    _, tracks, params = window()
    short = tracks.positions[:, :frames] + value
    guess = PhaseState(short, short)
    with pytest.raises(ValueError, match="got 2|finite"):
        smoothed(short, guess, params)


def test_an_unexplained_window_is_shortened_not_trusted():
    truth, tracks, params = window(episodes=24)
    broken = tracks.positions.clone()
    broken[3, :3] = tracks.positions[7, :3]  # in one episode, three frames of another
    state = by_shooting(
        SCENE.law, Tracks(broken, tracks.confidence, tracks.times), params, INTERVAL
    )
    clean = by_shooting(SCENE.law, tracks, params, INTERVAL)
    assert error(state, truth)[3] < 0.1
    others = torch.arange(24) != 3
    torch.testing.assert_close(state.q[others], clean.q[others], atol=1e-3, rtol=0)


@pytest.mark.parametrize("frames", [5, 7])
def test_two_bodies_that_circle_each_other_faster_than_frames_show_are_found(frames):
    start, params = SCENE.sample(2, Generator().manual_seed(4))
    start.q[0] = torch.tensor([[-0.189, 1.274], [-0.153, 0.059], [-0.173, 0.133]]).double()
    start.p[0] = torch.tensor([[-0.586, -0.707], [0.615, -0.387], [-0.028, 1.094]]).double()
    truth = SCENE.simulate(start, params, STRIDE * (frames - 1), STRIDE)
    found = sought(SCENE.law, truth.states.q, params, INTERVAL, largest=4.0)
    plain = central_difference(truth.states.q, params.mass, INTERVAL)
    close = [states.p[0, :, 1] - states.p[0, :, 2] for states in (truth.states, found, plain)]
    size = close[0].norm(dim=-1).max()
    assert (close[1] - close[0]).norm(dim=-1).max() < 0.15 * size
    assert (close[2] - close[0][1:-1]).norm(dim=-1).max() > 0.5 * size  # they say nothing of it
    assert (found.q[0] - truth.states.q[0]).norm(dim=-1).max() < 0.02


def test_a_law_is_trusted_where_positions_err_and_not_where_it_does():
    _, noisy, params = window(episodes=24, noise=0.01)
    trusted = choose_slack(SCENE.law, noisy, params, INTERVAL)
    _, exact, params = window(episodes=24)
    wrong = replace(params, coupling=0.5 * params.coupling)
    assert choose_slack(SCENE.law, exact, wrong, INTERVAL) > trusted
    assert trusted <= ShootingSettings().slacks[2]


class Heavier(FixedKinetic):
    """Bodies that move as if they had a fifth of their momentum."""

    def velocity(self, p, params):
        return super().velocity(p, params) / 5


def test_a_head_that_means_something_else_by_momentum_is_not_asked_for_the_start():
    _, tracks, params = window(episodes=24)
    head = Hamiltonian(Heavier(), NoPotential())
    slack = choose_slack(head, tracks, params, INTERVAL)
    assert slack == torch.inf
    start = by_shooting(head, tracks, params, INTERVAL, slack)
    assert torch.equal(start.p, by_differencing(head, tracks, params, INTERVAL).p)


def test_a_slope_that_foretells_badly_is_found_again():
    """The fit is as good as with slopes that are found again at every move."""
    truth, tracks, params = window(episodes=24, noise=0.002)
    guess = PhaseState(tracks.positions, torch.zeros_like(tracks.positions))
    seldom = smoothed(tracks.positions, guess, params)[-1]
    always = smoothed(tracks.positions, guess, params, foretold=0.0)[-1]
    never = smoothed(tracks.positions, guess, params, foretold=torch.inf)[-1]
    torch.testing.assert_close(seldom.cost, always.cost, rtol=0.02, atol=0)
    assert never.cost.mean() > 1.2 * always.cost.mean()
