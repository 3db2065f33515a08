"""Heads trained on positions alone: windows and their loss."""

import copy

import pytest
import torch
from torch import Generator

from binders import Tracks
from dynamics import HEADS, build
from vidphys.experiments.pixels.momentum import MOMENTUM
from vidphys.scenes import gravity
from vidphys.shooting.aim import surprise
from vidphys.training.tracks import TrackTask, Windows, tell_scale, window_loss

EVERY, INTERVAL, FRAMES = 40, 0.08, 9


@pytest.fixture(scope="module")
def seen():
    scene = gravity(mass=(1.0, 1.0))
    start, params = scene.sample(24, Generator().manual_seed(0))
    states = scene.simulate(start, params, EVERY * (FRAMES - 1), EVERY).states
    times = INTERVAL * torch.arange(FRAMES, dtype=torch.float64)
    return Tracks(states.q.float(), torch.ones(states.q.shape[:-1]), times), params


def task_of(seen, steps=40, **more):
    return TrackTask(*seen, INTERVAL, steps, 0, **more)


def test_windows_are_neighbouring_frames_of_one_clip(seen):
    windows = Windows(task_of(seen))
    assert len(windows) == 24 * (FRAMES - 3)
    batch = windows[torch.tensor([0, FRAMES - 3, 2 * (FRAMES - 3) - 1])]
    positions, params = seen[0].positions, seen[1]
    for row, (clip, frame) in enumerate([(0, 0), (1, 0), (1, FRAMES - 4)]):
        assert torch.equal(batch.positions[row], positions[clip, frame : frame + 4])
        assert batch.params.coupling[row] == params.coupling[clip].float()


def test_tracks_shorter_than_a_window_are_refused(seen):
    with pytest.raises(ValueError, match="windows of 12 frames, but the tracks have 9"):
        Windows(task_of(seen, ahead=10))


def test_the_true_law_explains_true_tracks_and_a_wrong_one_does_not(seen):
    law, task = gravity().law, task_of(seen)
    batch = Windows(task)[torch.arange(100)]
    right = float(window_loss(law, task)(batch))
    with torch.no_grad():
        free = float(window_loss(build(HEADS["factored"], 3, 0.01), task)(batch))
    assert right < 0.1 < free / 10


def test_a_body_that_nobody_is_sure_of_does_not_count(seen):
    law, task = gravity().law, task_of(seen)
    tracks, params = seen
    broken = tracks.positions.clone()
    broken[:, 5, 0] += 3
    sure = tracks.confidence.clone()
    sure[:, 5, 0] = 0
    whole = Windows(task)
    doubted = Windows(task_of((Tracks(broken, sure, tracks.times), params)))
    index = torch.arange(len(whole))
    loss = window_loss(law, task)
    kept = loss(doubted[index])
    # Windows around frame 5 fall out or lose one frame; nothing of the displacement is left.
    assert float(kept) <= float(loss(whole[index])) + 1e-6


def test_surprise_counts_small_errors_by_their_square_and_large_ones_by_their_logarithm():
    law, params = gravity().law, gravity().sample(1, Generator().manual_seed(1))[1]
    params = params.with_coupling(0.0)
    still = torch.zeros(1, 3, 3, 2, dtype=torch.float64)
    for error, expected in [(1e-3, 1e-2), (1.0, 9.21044)]:
        moved = still.clone()
        moved[:, 2, :, 0] = error
        found = surprise(law, moved, params, 0.01, 8)
        assert found.shape == (1, 1, 3)
        torch.testing.assert_close(found.mean().item(), expected, rtol=6e-3, atol=0)


@pytest.mark.parametrize("readout", ["differencing", "shooting"])
def test_training_lowers_the_surprise(seen, readout):
    torch.manual_seed(0)
    head, task = build(HEADS["factored"], 3, 0.01), task_of(seen)
    batch, loss = Windows(task)[torch.arange(144)], window_loss(head, task)
    with torch.no_grad():
        before = float(loss(batch))
    MOMENTUM[readout].train(head, task)
    with torch.no_grad():
        assert float(loss(batch)) < 0.7 * before


def test_training_goes_on_where_it_was(seen, tmp_path):
    torch.manual_seed(0)
    head = build(HEADS["factored"], 3, 0.01)
    whole, interrupted = copy.deepcopy(head), copy.deepcopy(head)
    MOMENTUM["shooting"].train(whole, task_of(seen, 6))

    def stop(step, _steps, _loss):
        if step == 3:
            import os
            import signal

            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        MOMENTUM["shooting"].train(interrupted, task_of(seen, 6, save_to=tmp_path, progress=stop))
    MOMENTUM["shooting"].train(interrupted, task_of(seen, 6, save_to=tmp_path))
    for a, b in zip(whole.parameters(), interrupted.parameters(), strict=True):
        assert torch.equal(a, b)


def test_training_keeps_the_scale_that_a_map_was_told(seen):
    head = build(HEADS["unstructured"], 3, 0.01)
    tell_scale(head, task_of(seen))
    kept = head.scale.clone()
    assert float(kept.max()) < 1
    for readout in MOMENTUM.values():
        readout.train(head, task_of(seen, 2))
        assert torch.equal(head.scale, kept)
