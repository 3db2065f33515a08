"""What a readout attends to is what its positions are made of."""

import pytest
import torch
from torch import nn

from encoders.features import FeatureMap
from readouts.attention import AttentionReadout
from readouts.local import RefinedReadout, blocks
from vidphys.reading.attention import MOST, attention_of, drawn_frames

FEATURES = FeatureMap(torch.randn(1, 3, 8, 32, 32), (2.0, 2.0), torch.arange(3.0))


@pytest.mark.parametrize("frames", [1, 2])
def test_shares_of_cells_give_the_positions(frames):
    torch.manual_seed(0)
    readout = AttentionReadout(8, 2 * frames, 16, frames=frames)
    drawn = torch.arange(0, 3 * frames, 2)
    shares = attention_of(readout, FEATURES, drawn)
    assert shares.shape == (len(drawn), 2, 32, 32)
    assert torch.allclose(shares.sum((-1, -2)), torch.ones(len(shares), 2))
    middle = torch.einsum("tnhw,hwd->tnd", shares, FEATURES.cell_centres())
    read, _ = readout(FEATURES)  # untrained, it corrects nothing
    read = read[0].unflatten(1, (frames, 2)).flatten(0, 1)
    assert torch.allclose(middle, read[drawn], atol=1e-6)


def test_a_refined_readout_looks_at_blocks_first_and_others_tell_nothing():
    torch.manual_seed(0)
    readout = RefinedReadout(8, 2, (32, 32))
    shares = attention_of(readout, FEATURES, torch.arange(3))
    values, centres = blocks(FEATURES.values[0], FEATURES.cell_centres(), 2)
    rough, _ = readout.coarse.look(values, centres)
    assert shares.shape == (3, 2, 16, 16)
    assert torch.allclose(torch.einsum("tnhw,hwd->tnd", shares, centres), rough, atol=1e-6)
    assert attention_of(nn.Identity(), FEATURES, torch.arange(3)) is None


def test_of_a_long_clip_so_many_frames_are_drawn_evenly():
    assert torch.equal(drawn_frames(MOST), torch.arange(MOST))
    assert torch.equal(drawn_frames(2 * MOST + 3), torch.arange(0, 2 * MOST + 3, 3))
