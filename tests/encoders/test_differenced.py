"""Frame differencing of image encoders: the features as they are, and their change in time."""

from __future__ import annotations

import pytest
import torch

from encoders.frozen import load_encoder
from encoders.frozen.windows import windows
from tests.shared.layers import expect_layers

COUNT = 13
TIMES = torch.arange(COUNT, dtype=torch.float64) / 10


def clip(frames=COUNT):
    rng = torch.Generator().manual_seed(1)
    return torch.rand(2, frames, 3, 24, 32, generator=rng)


@pytest.mark.parametrize("batch", [1, 3, 8])
@pytest.mark.parametrize("reach", [1, 2])
def test_features_and_their_change_whatever_the_windows(batch, reach):
    plain = load_encoder("dino-tiny", {"resolution": 32})
    options = {"resolution": 32, "difference": reach, "batch": batch}
    found = load_encoder("dino-tiny", options)(clip(), TIMES)
    own = plain(clip(), TIMES)
    assert found.times.tolist() == own.times.tolist() and found.stride == own.stride
    channels = own.values.shape[2]
    torch.testing.assert_close(found.values[:, :, :channels], own.values, atol=1e-5, rtol=1e-4)
    for frame in range(COUNT):
        before, after = max(frame - reach, 0), min(frame + reach, COUNT - 1)
        change = (own.values[:, after] - own.values[:, before]) / (after - before)
        told = found.values[:, frame, channels:]
        torch.testing.assert_close(told, change, atol=1e-5, rtol=1e-4)


def test_what_stands_still_does_not_change_and_one_frame_neither():
    encoder = load_encoder("dino-tiny", {"resolution": 32, "difference": 2, "layer": 1})
    still = clip(1).expand(-1, 5, -1, -1, -1)
    for frames in (still, clip(1)):
        found = encoder(frames, TIMES[: frames.shape[1]]).values
        plain, change = found.chunk(2, dim=2)
        assert plain.any() and float(change.abs().max()) < 1e-5 * float(plain.abs().max())


def test_all_layers_come_from_one_pass_and_each_is_another_encoder():
    options = {"resolution": 32, "difference": 1, "batch": 4}
    encoder = load_encoder("dino-tiny", options)
    passes = 2 * len(windows(COUNT, encoder.windowing))
    expect_layers(
        encoder,
        lambda layer: load_encoder("dino-tiny", {**options, "layer": layer}),
        clip(),
        passes,
    )
    others = [load_encoder("dino-tiny", {**options, "difference": reach}) for reach in (None, 2)]
    assert len({each.identity for each in (encoder, *others)}) == 3


def test_an_encoder_of_clips_has_no_frame_differencing():
    with pytest.raises(ValueError, match="no difference; it takes"):
        load_encoder("videomae-tiny", {"difference": 1})
    with pytest.raises(ValueError, match="difference 0: must be at least 1 frame"):
        load_encoder("timm:test_vit", {"seed": 0, "difference": 0})
