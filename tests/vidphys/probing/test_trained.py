import numpy as np
import pytest
import torch

from vidphys.probing.confidence import calibration_error
from vidphys.probing.folds import CrossValidation, Question, fold_of
from vidphys.probing.readouts import Linear
from vidphys.probing.trained import Attention


@pytest.fixture(scope="module")
def task():
    return marked(300)


def marked(count):
    """A number is written in one cell, which a mark in another channel shows; others say nothing.

    It is a product of mark and number, which nothing linear reads.
    """
    rng = np.random.default_rng(0)
    cells = 9
    maps, at = rng.normal(size=(count, 2, cells)), rng.integers(cells, size=count)
    maps[:, 1] = 0
    maps[np.arange(count), 1, at] = 3
    number = maps[np.arange(count), 0, at]
    clips = np.arange(count) // 2
    return torch.from_numpy(maps.reshape(count, 2, 3, 3)).float(), number[:, None, None], clips


def test_attention_reads_what_is_marked(task):
    maps, number, clips = task
    asked = CrossValidation(
        [Question(number, np.ones(len(clips), bool))], clips, fold_of(150, 2, 0), 0, True
    )
    (said,) = Attention(seeds=1, steps=300, rates=(1e-3, 1e-2))(maps, asked)
    (flat,) = Linear()(maps, CrossValidation(asked.questions, clips, asked.folds))
    score = [1 - ((s - number) ** 2).mean() / number.var() for s in (said.raw, flat.raw)]
    assert score[0] > 0.85 and score[1] < 0.5
    assert ((said.permuted - number) ** 2).mean() > 0.8 * number.var()
    assert said.doubt.shape == number.shape and np.all(said.doubt > 0)
    assert said.forms == {"attention": 2}


def test_attention_tells_classes_with_calibrated_probabilities():
    maps, number, clips = marked(900)
    chance = 1 / (1 + np.exp(-2 * number[:, 0, 0]))
    true = (np.random.default_rng(1).uniform(size=len(chance)) < chance).astype(int)
    question = Question(np.eye(2)[true][:, None], np.ones(len(clips), bool), True)
    asked = CrossValidation([question], clips, fold_of(450, 2, 0), 0)
    (said,) = Attention(seeds=2, steps=200, rates=(3e-3,))(maps, asked)
    assert said.raw.sum(-1) == pytest.approx(1)
    assert np.corrcoef(said.raw[:, 0, 1], chance)[0, 1] > 0.8
    assert calibration_error(said.raw[:, 0], true) < 0.1
