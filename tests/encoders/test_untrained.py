"""The control of pretraining: the same network, weights as before any training."""

import pytest
import torch
from torch import nn

from encoders.frozen import load_encoder
from encoders.frozen.untrained import drawn_anew, untrained
from encoders.release import WeightsMissing

CLIP = torch.randint(256, (1, 4, 3, 64, 64), generator=torch.Generator().manual_seed(0)).byte()
TIMES = torch.arange(4) * 0.1


@pytest.mark.parametrize("name", ["dino-tiny", "vjepa2-tiny"])
def test_weights_are_drawn_anew_by_their_seed_and_nothing_else_is_touched(name):
    trained, *loaded = (load_encoder(name, {}) for _ in range(4))
    before = torch.get_rng_state()
    first, again, other = map(untrained, loaded, (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), before)
    maps = [encoder(CLIP, TIMES).values for encoder in (trained, first, again, other)]
    assert maps[0].shape == maps[1].shape and bool(torch.isfinite(maps[1]).all())
    assert torch.equal(maps[1], maps[2])
    assert not torch.allclose(maps[0], maps[1]) and not torch.allclose(maps[1], maps[3])
    kept = dict(trained.network.named_parameters())
    for key, weight in first.network.named_parameters():
        if weight.dim() > 1:
            assert not torch.equal(weight, kept[key]), key
    told = {encoder.identity.weights_sha256 for encoder in (trained, first, other)}
    assert len(told) == 3 and first.identity == again.identity


@pytest.mark.parametrize("name", ["dino-tiny", "videomae-tiny", "vjepa2-tiny"])
def test_a_seed_needs_no_weights_and_draws_the_same(name, tmp_path, monkeypatch):
    drawn = untrained(load_encoder(name, {}), 3)
    seeded = load_encoder(name, {"seed": 3})
    assert seeded.identity == drawn.identity
    assert torch.equal(seeded(CLIP, TIMES).values, drawn(CLIP, TIMES).values)


def test_networks_without_any_file_are_built_as_they_are_released(tmp_path, monkeypatch):
    monkeypatch.setenv("VIDPHYS_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    before = torch.get_rng_state()
    videomae = load_encoder("videomae-small", {"seed": 0})
    dinov2 = load_encoder("dinov2-small", {"seed": 0, "resolution": 56})
    assert torch.equal(torch.get_rng_state(), before)
    assert videomae.network.config.hidden_size == 384 and len(videomae.layers) == 12
    assert dinov2(CLIP[:, :1], TIMES[:1]).values.shape == (1, 1, 384, 4, 4)
    assert (
        load_encoder("i3d", {"seed": 0}).identity.weights_sha256
        == "drawn anew by seed 0, version 2"
    )
    with pytest.raises(WeightsMissing, match=r"no file but config.json.*hf download a/b config"):
        load_encoder("hf:a/b", {"seed": 0})


def test_vectors_that_scale_begin_at_one_and_places_are_drawn():
    class LayerScale(nn.Module):
        """As some libraries have it: near zero, so that a new block does nothing."""

        def __init__(self):
            super().__init__()
            self.gamma = nn.Parameter(torch.empty(8))
            self.reset_parameters()

        def reset_parameters(self):
            nn.init.constant_(self.gamma, 1e-5)

    class Blocks(nn.Module):
        def __init__(self):
            super().__init__()
            self.token, self.lambda1 = (nn.Parameter(torch.full((8,), 5.0)) for _ in range(2))
            self.scale = LayerScale()

    found = drawn_anew(Blocks(), 0)
    assert found.lambda1.tolist() == found.scale.gamma.tolist() == [1.0] * 8
    assert 0 < float(found.token.detach().abs().max()) < 0.1


def test_an_encoder_that_shows_no_network_is_refused():
    encoder = load_encoder("dino-tiny", {})

    class Theirs:
        identity, frames_per_feature = encoder.identity, 1

        def __call__(self, frames, times, progress=None):
            raise NotImplementedError

    with pytest.raises(ValueError, match="only a FrozenEncoder .* got Theirs"):
        untrained(Theirs(), 0)
