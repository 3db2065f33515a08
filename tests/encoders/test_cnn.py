"""The convolutional encoder, soft-argmax, and the parts of a JEPA."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from encoders import Encoder, FeatureMap
from encoders.cnn import ConvEncoder
from encoders.jepa import EmaTarget, ema_momentum, variance_floor
from readouts.soft_argmax import SoftArgmax, soft_argmax


def cells(h: int, w: int) -> torch.Tensor:
    return FeatureMap(torch.zeros(1, 1, 1, h, w), (2.0, 2.0), torch.zeros(1)).cell_centres()


def test_the_encoder_has_the_studys_number_of_parameters():
    count = sum(p.numel() for p in ConvEncoder(3).parameters())
    assert abs(count - 383_000) < 0.03 * 383_000


@pytest.mark.parametrize(("channels", "h", "w"), [(3, 32, 32), (1, 64, 64), (5, 32, 48)])
def test_the_feature_map_covers_the_image(channels, h, w):
    encoder: Encoder = ConvEncoder(channels)
    times = torch.tensor([0.0, 0.08])
    features = encoder(torch.rand(2, 2, channels, h, w), times)
    assert features.values.shape == (2, 2, 16, h // 2, w // 2)
    assert features.grid == (h // 2, w // 2)
    assert (features.grid[0] * features.stride[0], features.grid[1] * features.stride[1]) == (h, w)
    assert torch.equal(features.times, times)


def test_each_frame_is_encoded_by_itself():
    encoder, frames = ConvEncoder(2), torch.rand(3, 4, 2, 32, 32)
    whole = encoder(frames, torch.arange(4.0)).values
    alone = encoder(frames[1:2, 2:3], torch.zeros(1)).values
    assert torch.allclose(whole[1:2, 2:3], alone, atol=1e-5)


def test_every_parameter_of_encoder_and_readout_is_used():
    encoder, readout = ConvEncoder(2), SoftArgmax(16, 2)
    positions, _ = readout(encoder(torch.rand(2, 1, 2, 32, 32), torch.zeros(1)))
    positions.square().sum().backward()
    for name, parameter in (*encoder.named_parameters(), *readout.named_parameters()):
        if name != "project.bias":  # a constant added to all logits has no effect
            assert parameter.grad is not None and parameter.grad.abs().max() > 0, name


@pytest.mark.parametrize(
    ("shape", "word"), [((1, 1, 2, 32, 32), "channels"), ((1, 1, 3, 32, 40), "multiples of 16")]
)
def test_wrong_frames_are_named(shape, word):
    with pytest.raises(ValueError, match=word):
        ConvEncoder(3)(torch.zeros(shape), torch.zeros(1))


@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_soft_argmax_finds_the_centre_of_a_gaussian_between_cells(x, y):
    at, centres = torch.tensor([x, y], dtype=torch.float64), cells(16, 16).double()
    squared = (centres - at).square().sum(-1)
    found, confidence = soft_argmax(-squared / (2 * 0.1**2), centres)
    assert (found - at).abs().max() < 2e-3
    assert 0.9 < confidence < 1


def test_soft_argmax_keeps_axes_apart_on_an_oblong_map():
    logits = torch.full((8, 16), -100.0)
    logits[0, 15] = 0.0  # top right
    found, confidence = soft_argmax(logits, cells(8, 16))
    assert torch.allclose(found, torch.tensor([15 / 16, 7 / 16]))
    assert confidence == pytest.approx(1, abs=1e-6)


def test_soft_argmax_is_differentiable(float64):
    centres = cells(3, 4).double()
    logits = torch.randn(2, 3, 4, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: soft_argmax(x, centres), (logits,))


def test_a_flat_map_is_flagged_and_in_the_middle():
    found, confidence = soft_argmax(torch.full((2, 16, 16), 3.0), cells(16, 16))
    assert torch.allclose(found, torch.zeros(2, 2), atol=1e-6)
    assert confidence.max() < 1e-4
    noisy = soft_argmax(0.1 * torch.randn(50, 16, 16), cells(16, 16))[1]
    assert noisy.max() < 0.02


def test_confidence_falls_as_the_heat_spreads():
    centres = cells(16, 16)
    squared = centres.square().sum(-1)
    widths = [0.1, 0.2, 0.4, 0.8]
    confidence = [float(soft_argmax(-squared / (2 * w**2), centres)[1]) for w in widths]
    assert confidence == sorted(confidence, reverse=True)
    assert confidence[0] - confidence[-1] > 0.5


def test_one_cell_is_certain():
    found, confidence = soft_argmax(torch.tensor([[2.0]]), cells(1, 1))
    assert confidence == 1 and torch.equal(found, torch.zeros(2))


def test_a_temperature_must_be_positive():
    with pytest.raises(ValueError, match="temperature"):
        SoftArgmax(4, 2, temperature=0.0)


def test_lower_temperature_is_a_more_pointed_heat():
    features = FeatureMap(torch.randn(1, 1, 4, 8, 8), (2.0, 2.0), torch.zeros(1))
    readout = SoftArgmax(4, 2)
    _, before = readout(features)
    with torch.no_grad():
        readout.log_temperature -= math.log(10)
    assert (readout(features)[1] > before).all()


def test_the_target_starts_equal_moves_towards_the_online_module_and_is_not_trained():
    online = nn.Linear(3, 2)
    target = EmaTarget(online, updates=100)
    assert torch.equal(target.module.weight, online.weight)
    before = target.module.weight.clone()
    with torch.no_grad():
        online.weight += 1
    target.update(online)
    moved = target.module.weight - before
    assert torch.allclose(moved, torch.full_like(moved, 0.9))  # first momentum: 1 / 10
    assert not any(p.requires_grad for p in target.parameters())
    assert online.weight.requires_grad


def test_the_momentum_rises_to_one():
    assert ema_momentum(0.0) == pytest.approx(0.996)
    assert ema_momentum(0.5) == pytest.approx(0.998)
    assert ema_momentum(1.0) == ema_momentum(2.0) == 1
    target = EmaTarget(nn.Linear(1, 1), updates=10_000)
    target.updated += 5_000
    assert target.momentum == pytest.approx(0.998, abs=1e-5)
    target.updated += 5_000
    assert target.momentum == pytest.approx(10_001 / 10_010)


def test_the_monitor_sees_one_collapsed_coordinate():
    latents = torch.randn(50, 4, 3, 2)
    assert variance_floor(latents) > 0.5
    latents[:, :, 1, 0] = 0.3
    assert variance_floor(latents) < 1e-12
