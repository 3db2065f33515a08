import numpy as np
import pytest
import torch

from vidphys.probing.linear import fold_of
from vidphys.probing.readouts import Linear
from vidphys.probing.trained import Attention


@pytest.fixture(scope="module")
def task():
    """A number is written in one cell, which a mark in another channel shows; others say nothing.

    It is a product of mark and number, which nothing linear reads.
    """
    rng = np.random.default_rng(0)
    count, cells = 300, 9
    maps, at = rng.normal(size=(count, 2, cells)), rng.integers(cells, size=count)
    maps[:, 1] = 0
    maps[np.arange(count), 1, at] = 3
    number = maps[np.arange(count), 0, at]
    clips = np.arange(count) // 2
    return torch.from_numpy(maps.reshape(count, 2, 3, 3)).float(), number[:, None, None], clips


def test_attention_reads_what_is_marked(task):
    maps, number, clips = task
    how = [np.ones(len(clips), bool)], clips, fold_of(150, 2, 0), 0, True
    (said,) = Attention(seeds=1, steps=300, rates=(1e-3, 1e-2))(maps, [number], *how)
    (flat,) = Linear()(maps, [number], *how)
    score = [1 - ((s - number) ** 2).mean() / number.var() for s in (said.raw, flat.raw)]
    assert score[0] > 0.85 and score[1] < 0.5
    assert ((said.permuted - number) ** 2).mean() > 0.8 * number.var()
    assert said.doubt.shape == number.shape and np.all(said.doubt > 0)
