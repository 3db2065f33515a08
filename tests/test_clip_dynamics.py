"""The dynamics of a real clip, on a made pendulum whose motion is known."""

import math

import pytest
import torch

from binders import Tracks
from vidphys.errors import InputError
from vidphys.experiments import clip_dynamics
from vidphys.experiments.clip_dynamics import (
    Curve,
    _phases,
    forecast,
    forecast_error,
    naive_forecasts,
)

RATE, FRAMES, END = 30.0, 150, 100


def pendulum(bodies: int = 1) -> Tracks:
    t = torch.arange(FRAMES, dtype=torch.float64) / RATE
    angle = 0.5 * torch.exp(-0.1 * t) * torch.cos(2 * math.pi * t / 1.3)
    place = torch.stack([0.8 * angle.sin(), -0.8 * angle.cos()], -1)
    positions = place[None, :, None].expand(1, FRAMES, bodies, 2).contiguous()
    return Tracks(positions, torch.ones(1, FRAMES, bodies).double(), t)


def test_the_curve_and_its_coordinate_are_inverse_on_the_curve():
    track = pendulum()
    curve = Curve.through(track.positions[0, :END, 0])
    s = curve.coordinate(track.positions)
    assert float(s[:, :END].std()) == pytest.approx(1.0, abs=0.02)
    torch.testing.assert_close(curve.place(s), track.positions, atol=2e-3, rtol=0)


def test_a_body_at_rest_has_no_curve():
    with pytest.raises(InputError, match="does not move"):
        Curve.through(torch.zeros(10, 2))


def test_sampling_phases_end_at_the_last_training_frames():
    numbers = torch.arange(20.0).reshape(1, 20, 1, 1)
    samples = _phases(numbers, torch.ones(1, 20, 1), every=3, end=20)
    assert samples.positions[:, -1, 0, 0].tolist() == [19.0, 18.0, 17.0]
    steps = samples.positions.diff(dim=1)
    assert torch.equal(steps, torch.full_like(steps, 3.0)) and samples.positions.min() >= 0


def test_errors_are_zero_on_the_truth_and_skip_unsure_frames():
    track = pendulum()
    scored = torch.arange(END, FRAMES)
    assert forecast_error(track.times, track.positions[0], track, scored) == pytest.approx(0)
    broken = track.positions.clone()
    broken[0, 120] += 5
    sure = track.confidence.clone()
    sure[0, 120] = 0
    seen = Tracks(broken, sure, track.times)
    assert forecast_error(track.times, track.positions[0], seen, scored) == pytest.approx(0)


def test_naive_forecasts_stay_or_go_straight():
    track = pendulum()
    naive = naive_forecasts(track, END)
    times, stay = naive["persistence"]
    assert torch.equal(stay[-1], track.positions[0, END - 1])
    _, straight = naive["constant-velocity"]
    torch.testing.assert_close(straight[0], track.positions[0, END - 1])
    assert len(times) == len(straight) == FRAMES - END + 1


def test_a_forecast_goes_past_the_clip_and_beats_standing_still(monkeypatch):
    monkeypatch.setattr(clip_dynamics, "STEPS", 150)
    track = pendulum()
    found = forecast("damped", track, END, beyond=1.0, seed=0)
    assert float(found.times[0]) == pytest.approx(float(track.times[END - 1]))
    assert float(found.times[-1]) == pytest.approx(float(track.times[-1]) + 1.0, abs=0.05)
    assert found.friction is not None and found.friction > 0
    scored = torch.arange(END, END + 25)
    error = forecast_error(found.times, found.positions, track, scored)
    times, stay = naive_forecasts(track, END)["persistence"]
    assert error < 0.5 * forecast_error(times, stay, track, scored)


def test_two_bodies_are_refused():
    with pytest.raises(InputError, match="one body"):
        forecast("damped", pendulum(2), END, 1.0, 0)
