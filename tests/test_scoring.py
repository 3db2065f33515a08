"""Questions: from another start it is the same question, and the truth is asked once."""

import dataclasses

import torch

from vidphys.experiments.scoring import Question
from vidphys.scenes import gravity


def test_another_start_shares_what_the_truth_answers_and_changes_nothing_of_it(monkeypatch):
    scene = gravity()
    truth, params = scene.sample(2, torch.Generator().manual_seed(0))
    asked = Question(scene, truth, truth, params, steps=20)
    rolled = []
    simulate = type(scene).simulate

    def counted(*arguments, **named):
        rolled.append(arguments)
        return simulate(*arguments, **named)

    monkeypatch.setattr(type(scene), "simulate", counted)
    moved = asked.starting(truth.map(lambda x: x + 0.1))
    flipped = params.with_coupling(-1.0)
    first = asked.reference(flipped)
    assert moved.reference(flipped) is first and len(rolled) == 1
    assert moved.truth is truth and not torch.equal(moved.start.q, truth.q)
    torch.testing.assert_close(first.states.q[:, 0], truth.q)
    # another law, and the same question asked over another time, are rolled anew
    assert not torch.equal(moved.reference(params).states.q, first.states.q)
    longer = dataclasses.replace(asked, steps=40).reference(flipped)
    assert len(rolled) == 3 and longer.states.q.shape[1] == 9
