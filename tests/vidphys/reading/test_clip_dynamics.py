"""What is fitted to tracks and where it goes: charts, stretches, forecasts, on known motion."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from binders import Tracks
from dynamics import HEADS, Parameters, PhaseState, build, rollout, terms
from dynamics.compiled.choice import FEW, PAYS, TOLERANCE
from vidphys.data.charts import Curve, Plane, chart_from_config, chart_of
from vidphys.errors import InputError
from vidphys.reading.clip_dynamics import (
    Dynamics,
    Followed,
    fit_head,
    friction_of,
    sample,
    terms_of,
)
from vidphys.reading.forecasts import Forecast, forecast, forecast_error, naive_forecasts, state_at
from vidphys.reading.laws import Law
from vidphys.shooting import step

RATE, FRAMES, END = 30.0, 150, 100


def law(bodies: int = 1) -> Parameters:
    return Parameters(torch.ones(1), torch.ones(1, bodies))


def pendulum(bodies: int = 1) -> Tracks:
    t = torch.arange(FRAMES, dtype=torch.float64) / RATE
    angle = 0.5 * torch.exp(-0.1 * t) * torch.cos(2 * math.pi * t / 1.3)
    place = torch.stack([0.8 * angle.sin(), -0.8 * angle.cos()], -1)
    positions = place[None, :, None].expand(1, FRAMES, bodies, 2).contiguous()
    return Tracks(positions, torch.ones(1, FRAMES, bodies).double(), t)


def numbered(frames: int) -> Followed:
    """A track whose position is its frame's number."""
    place = torch.arange(float(frames)).reshape(1, frames, 1, 1).expand(-1, -1, -1, 2)
    times = torch.arange(frames, dtype=torch.float64) / RATE
    return Followed(Tracks(place, torch.ones(1, frames, 1), times), law())


def test_the_curve_and_its_coordinate_are_inverse_on_the_curve():
    track = pendulum()
    curve = Curve.through(track.positions[0, :END, 0])
    s = curve.coordinate(track.positions)
    assert float(s[:, :END].std()) == pytest.approx(1.0, abs=0.02)
    torch.testing.assert_close(curve.place(s), track.positions, atol=2e-3, rtol=0)
    again = chart_from_config(curve.to_config())
    assert torch.equal(again.coordinate(track.positions), s)


def test_one_body_on_a_curve_needs_one_coordinate_others_the_plane():
    track = pendulum()
    assert chart_of(track.positions[0]).kind == "curve"
    assert chart_of(pendulum(2).positions[0]) == Plane()
    t = torch.linspace(0, 6.3, 60)
    ring = torch.stack([t.cos(), t.sin()], -1)[:, None]
    assert chart_of(ring) == Plane() == chart_from_config(Plane().to_config())
    with pytest.raises(InputError, match="does not move"):
        chart_of(torch.zeros(10, 1, 2))


def test_stretches_end_at_the_last_known_frames_and_are_of_equal_length():
    samples = sample([numbered(20), numbered(50), numbered(9)], [20, 45, 0], Plane())
    assert samples.interval == pytest.approx(0.1)
    ends = samples.tracks.positions[:, -1, 0, 0].tolist()
    assert ends == [19, 18, 17, 44, 26, 43, 25, 42, 24]
    steps = samples.tracks.positions.diff(dim=1)
    assert torch.equal(steps, torch.full_like(steps, 3.0))
    assert samples.tracks.positions.shape == (9, 6, 1, 2) and samples.tracks.positions.min() >= 0
    assert samples.law.mass.shape == (9, 1)


def test_clips_that_are_too_short_have_no_dynamics():
    with pytest.raises(InputError, match="11 frames to train on, 3 samples"):
        sample([numbered(11)], [11], Plane())


def test_errors_are_zero_on_the_truth_and_skip_unsure_frames():
    track = pendulum(2)
    scored = torch.arange(END, FRAMES)
    truth = Forecast(track.times, track.positions[0])
    assert forecast_error(truth, track, scored) == pytest.approx(0)
    off = Forecast(track.times, track.positions[0] + torch.tensor([3.0, 4.0]))
    assert forecast_error(off, track, scored) == pytest.approx(5)
    broken, sure = track.positions.clone(), track.confidence.clone()
    broken[0, 120, 1] += 5
    assert forecast_error(truth, Tracks(broken, sure, track.times), scored) > 0.1
    sure[0, 120, 1] = 0
    assert forecast_error(truth, Tracks(broken, sure, track.times), scored) == pytest.approx(0)


def test_naive_forecasts_stay_or_go_straight():
    track = pendulum()
    naive = naive_forecasts(track, END)
    assert torch.equal(naive["persistence"].positions[-1], track.positions[0, END - 1])
    straight = naive["constant-velocity"]
    torch.testing.assert_close(straight.positions[0], track.positions[0, END - 1])
    speed = (track.positions[0, END - 1] - track.positions[0, END - 3]) / 2
    torch.testing.assert_close(straight.positions[2] - straight.positions[1], speed)
    assert len(straight.times) == FRAMES - END + 1


@pytest.fixture
def coarse(monkeypatch):
    """Few model steps a frame: what is tested here does not need more."""
    monkeypatch.setattr(step, "HEAD_DT", 0.05)


def test_a_forecast_beats_standing_still_and_the_law_can_be_changed(coarse):
    seen, known = Followed(pendulum(), law()), [END]
    chart = chart_of(seen.track.positions[0, :END])
    samples = sample([seen], known, chart)
    terms = {"factored": terms_of(chart, 1, friction=True)["factored"]}
    head = fit_head(terms["factored"], samples, chart, 150, 1)
    dynamics = Dynamics(chart, samples.interval, terms, {"factored": head})
    start, began = state_at(head, seen, END, dynamics), float(seen.track.times[END - 1])
    found = forecast(head, start, seen.law, dynamics, began, 2.0)
    assert float(found.times[0]) == pytest.approx(began)
    assert float(found.times[-1]) == pytest.approx(began + 2, abs=0.05)
    scored = torch.arange(END, END + 25)
    stay = naive_forecasts(seen.track, END)["persistence"]
    error = forecast_error(found, seen.track, scored)
    assert error < 0.5 * forecast_error(stay, seen.track, scored)
    assert friction_of(head) > 0
    force = head.force(start, seen.law)
    torch.testing.assert_close(head.force(start, seen.law.with_coupling(-1.0)), -force)
    bare = Law(head, seen.law).changed({"friction": 0}).head
    assert friction_of(bare) == pytest.approx(0, abs=1e-9)
    torch.testing.assert_close(bare.force(start, seen.law), force)
    for model, conserving in ((bare, True), (head, False)):
        energy = head.energy(rollout(model, start, seen.law, 400, 5e-3).states, seen.law)
        lost = float((energy[0, 0] - energy[0, -1]).detach())
        assert (abs(lost) < 0.02) == conserving and lost > -0.02


def test_only_bodies_in_a_plane_have_a_pair_law_and_friction_can_be_left_out():
    curve = chart_of(pendulum().positions[0])
    assert terms_of(curve, 1, True)["factored"].potentials == (terms.Mapped(width=32),)
    assert terms_of(Plane(), 1, True)["factored"].potentials == (terms.Mapped(),)
    assert terms.Mapped().features == "linear"
    pair = terms_of(Plane(), 3, False)["factored"]
    assert pair.potentials == (terms.Displacement(),) and pair.ports == ()


def test_a_start_needs_the_rate_of_the_training_and_three_samples():
    seen = Followed(pendulum(), law())
    dynamics = Dynamics(Plane(), 0.1, {}, {})
    with pytest.raises(InputError, match="start state needs three"):
        state_at(None, seen, 6, dynamics)
    slow = Tracks(seen.track.positions, seen.track.confidence, seen.track.times * 3.5)
    with pytest.raises(InputError, match=r"8\.571 frames per second"):
        state_at(None, Followed(slow, law()), END, dynamics)


def test_curves_survive_json():
    curve = chart_of(pendulum().positions[0])
    assert all(isinstance(x, float) for x in curve.to_config()["bend"])
    np.testing.assert_array_equal(chart_from_config(curve.to_config()).bend, curve.bend)


def test_a_long_forecast_of_a_pair_law_is_its_splines_and_says_so():
    plain = HEADS["factored-radial"]
    rubbed = replace(plain, ports=(terms.LinearFriction(),))
    start = PhaseState(torch.tensor([[[0.0, 0.0], [1.0, 0.5]]]), torch.zeros(1, 2, 2))
    seconds, said = -(-PAYS // FEW) * step.HEAD_DT, {}
    for name, term, whole in (("long", plain, 1), ("short", plain, 0.5), ("rubbed", rubbed, 1)):
        torch.manual_seed(0)
        head = build(term, 2, step.HEAD_DT)
        dynamics = Dynamics(Plane(), 0.1, {}, {})
        found = forecast(head, start, law(2), dynamics, 0.0, whole * seconds)
        exact = rollout(head, start, law(2), 200, step.HEAD_DT).states.q[0].double()
        torch.testing.assert_close(found.positions[:201], exact, rtol=1e-4, atol=1e-4)
        said[name] = found.ran
    assert said["long"].spline.error <= said["long"].spline.tolerance == TOLERANCE
    assert (said["long"].backend, said["long"].why) == ("numba", "")
    assert said["short"].spline is None and "too few for a spline" in said["short"].why
    assert said["rubbed"].spline is None and "with no ports" in said["rubbed"].why
