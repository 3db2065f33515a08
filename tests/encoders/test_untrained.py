"""The control of pretraining: the same network, weights as before any training."""

import pytest
import torch

from encoders.frozen import load_encoder
from encoders.frozen.untrained import untrained

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


def test_an_encoder_that_shows_no_network_is_refused():
    encoder = load_encoder("dino-tiny", {})

    class Theirs:
        identity, frames_per_feature = encoder.identity, 1

        def __call__(self, frames, times, progress=None):
            raise NotImplementedError

    with pytest.raises(ValueError, match="only a FrozenEncoder .* got Theirs"):
        untrained(Theirs(), 0)
