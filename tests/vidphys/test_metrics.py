"""K1-K7: hand-made rollouts whose scores are known."""

import math
import statistics

import pytest
import torch

from dynamics import PhaseState
from vidphys import metrics as m


def states(q: torch.Tensor) -> PhaseState:
    return PhaseState(q, torch.zeros_like(q))


def line(slope: float, episodes: int = 4, steps: int = 6) -> PhaseState:
    t = torch.arange(steps, dtype=torch.float64)
    q = (slope * t)[None, :, None, None].expand(episodes, steps, 1, 2).clone()
    return states(q)


def test_energy_drift_is_relative_and_guarded_near_zero():
    energy = torch.tensor([[2.0, 1.0], [1e-9, 0.5]], dtype=torch.float64)
    drift = m.energy_drift(energy, torch.tensor([4.0, 5.0], dtype=torch.float64))
    assert drift[0, 1] == 0.5
    assert drift[1, 1] == pytest.approx(0.1, rel=1e-7)


def test_nonfinite_episodes_are_counted_and_get_no_number():
    values = torch.tensor([1.0, float("nan"), 3.0, float("inf"), 2.0])
    assert m.median(values) == m.Summary(2.0, "ok", 5, 2)
    assert m.worst(values).value == 3.0
    assert m.fraction_over_one(values).value == pytest.approx(2 / 3, rel=3e-15)
    assert m.median(torch.full((3,), float("nan"))) == m.Summary(None, "failed", 3, 3)
    assert m.worst(torch.zeros(0)) == m.Summary(None, "failed", 0, 0)


@pytest.mark.parametrize("name", ["median", "mean", "worst", "fraction_over_one"])
def test_the_count_of_lost_episodes_stands_beside_every_summary(name):
    for lost in range(5):
        values = torch.tensor([1.0, 3.0, 2.0, 5.0])
        values[:lost] = torch.tensor([math.nan, math.inf, -math.inf, math.nan])[:lost]
        found = getattr(m, name)(values)
        assert (found.episodes, found.nonfinite) == (4, lost)
        assert (found.value is None) == (lost == 4) == (found.status == m.FAILED)


@pytest.mark.parametrize("kind", ["auroc", "above"])
def test_the_share_of_larger_ones_counts_ties_half_and_the_lost(kind):
    ones = torch.tensor([1.0, 2.0, math.nan, 5.0, 3.0])
    others = torch.tensor([0.0, 2.0, 1.0, 9.0, 4.0])
    whole = [x for x in ones.tolist() if math.isfinite(x)]
    pairs = [(a, b) for a in whole for b in others.tolist()]
    if kind == "above":
        pairs = [(1.0, 0.0), (2.0, 2.0), (5.0, 9.0), (3.0, 4.0)]
    share = sum(1.0 if a > b else 0.5 if a == b else 0.0 for a, b in pairs) / len(pairs)
    count = 10 if kind == "auroc" else 5
    assert getattr(m, kind)(ones, others) == m.Summary(share, "ok", count, 1)
    nothing = getattr(m, kind)(torch.full((5,), math.nan), others)
    assert nothing == m.Summary(None, "failed", count, 5)


def test_the_median_of_an_even_number_lies_midway():
    assert m.median(torch.tensor([4.0, 1.0, 9.0, 2.0])).value == 3.0
    ends = torch.arange(30, dtype=torch.float64).square()
    curves = torch.stack([torch.zeros(30, dtype=torch.float64), ends], 1)
    generator = torch.Generator().manual_seed(0)
    slopes = [
        statistics.median(ends[torch.randint(30, (30,), generator=generator)].tolist())
        for _ in range(m.RESAMPLES)
    ]
    found = m.median_slope_interval(curves, 1.0)
    wanted = torch.tensor(slopes, dtype=torch.float64)
    low, high = float(wanted.quantile(0.025)), float(wanted.quantile(0.975))
    assert found == pytest.approx((low, high), rel=1e-12)


def test_a_ratio_without_its_denominator_is_no_number():
    error = m.Summary(0.1, "ok", 4, 0)
    for below in (m.Summary(None, "failed", 4, 2), m.Summary(0.0, "ok", 4, 0)):
        assert m.ratio(error, below) == m.Summary(None, "failed", 4, below.nonfinite)
    assert m.ratio(error, m.Summary(5e-324, "ok", 4, 0)).status == "failed"
    assert m.ratio(m.Summary(None, "failed", 4, 1), error) == m.Summary(None, "failed", 4, 1)
    assert m.ratio(m.Summary(0.0, "ok", 4, 0), error).value == 0


def test_there_is_no_gate_without_the_zero_force_error():
    match, error = m.Summary(1.0, "ok", 4, 0), m.Summary(0.1, "ok", 4, 0)
    lost = m.Summary(None, "failed", 4, 1)
    assert m.gated_regime_match(match, error, lost) == m.Summary(None, "failed", 4, 1)
    assert m.gated_regime_match(match, lost, error) == m.Summary(None, "failed", 4, 1)
    assert m.gated_regime_match(lost, error, error) == lost


def test_an_error_too_large_for_a_number_is_none():
    far = states(line(1.0).q * 1e200)
    assert m.nmse(far, line(1.0)) == m.Summary(None, "failed", 4, 0)
    assert m.Summary.of(math.nan, 4, 1) == m.Summary(None, "failed", 4, 1)


def test_nmse_pools_variance_over_all_channels_of_q_and_p():
    reference = line(1.0)
    shifted = states(reference.q + 1.0)
    variance = reference.flat.var(correction=0)
    # Only q is off by one: half of the channels.
    assert m.nmse(shifted, reference).value == pytest.approx(float(0.5 / variance), rel=3e-15)
    per_episode = m.episode_nmse(shifted, reference)
    assert per_episode.mean() == pytest.approx(m.nmse(shifted, reference).value, rel=3e-15)


def test_one_lost_episode_fails_the_pooled_error():
    broken = line(1.0)
    broken.q[2, 3] = float("nan")
    assert m.nmse(broken, line(1.0)) == m.Summary(None, "failed", 4, 1)
    assert m.regime_match(broken, line(1.0), line(-1.0)).status == "failed"


def test_nmse_refuses_a_reference_that_does_not_vary():
    with pytest.raises(ValueError, match="does not vary"):
        m.nmse(line(1.0), line(0.0))


def test_regime_match_compares_distances_not_normalised_errors():
    flipped, trained = line(-1.0), line(3.0)
    assert m.regime_match(line(-0.9), flipped, trained).value == 1
    assert m.regime_match(line(2.9), flipped, trained).value == 0
    # Nearer to flipped (1.5 against 2.5) although trained has the larger variance.
    assert m.regime_match(line(0.5), flipped, trained).value == 1


def test_ties_do_not_match():
    assert m.regime_match(line(0.0), line(-1.0), line(1.0)).value == 0


def test_the_gate_refuses_a_match_that_a_ballistic_predictor_beats():
    match = m.Summary(1.0, "ok", 4, 0)
    worse, better = m.Summary(0.2, "ok", 4, 0), m.Summary(0.1, "ok", 4, 0)
    assert m.gated_regime_match(match, worse, better).status == "invalid"
    assert m.gated_regime_match(match, better, worse).value == 1.0
    assert m.ratio(better, worse).value == pytest.approx(0.5, rel=3e-15)


def test_cosine_sees_direction_and_sign():
    force = torch.randn(5, 3, 2)
    assert m.cosine(2 * force, force).value == pytest.approx(1.0, rel=3e-15)
    assert m.cosine(-force, force).value == pytest.approx(-1.0, rel=3e-15)


def test_affine_residual_is_zero_for_an_affine_latent_and_one_for_noise():
    generator = torch.Generator().manual_seed(0)
    state = torch.randn(400, 4, generator=generator, dtype=torch.float64)
    latent = state @ torch.randn(4, 4, generator=generator, dtype=torch.float64) + 2.0
    assert m.affine_residual(latent, state).value < 3e-15
    noise = torch.randn(400, 4, generator=generator, dtype=torch.float64)
    assert 0.9 < m.affine_residual(noise, state).value < 1.2
    # a map that is fitted to hardly more episodes than it has numbers fits them, and nothing else
    assert m.affine_residual(noise, state, 7).value > 1.5
    assert m.affine_residual(noise, state, 390).value == pytest.approx(1.0, abs=0.3)


def test_latent_growth_is_a_ratio_of_norms():
    q = torch.ones(3, 5, 1, 2) * torch.tensor([1.0, 1, 1, 1, 4])[None, :, None, None]
    assert m.latent_growth(states(q), 4).value == pytest.approx(4.0, rel=3e-15)
