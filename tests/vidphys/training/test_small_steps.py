"""A training's small steps leave torch's threads to what needs them."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from dynamics import Parameters, PhaseState
from loops.threads import held_to
from vidphys.training.learner import FitSettings, Learner
from vidphys.training.segments import Segments


@pytest.fixture
def three_threads():
    with held_to(3):
        yield


def trained(width):
    """A step whose gradient needs no product: some add in another order with more threads."""
    torch.manual_seed(0)
    module = nn.Linear(width, width)
    seen = []
    learner = Learner(module, lambda x: (x * module.weight**2).sum(), FitSettings(9, 1, 1e-2))
    learner.optimiser.register_step_pre_hook(lambda *_: seen.append(torch.get_num_threads()))
    learner.update(torch.ones(width, width))
    return module, seen


def test_one_thread_updates_a_small_model_and_all_a_large_one(three_threads):
    assert [trained(width)[1] for width in (8, 600)] == [[1], [3]]
    assert torch.get_num_threads() == 3


def test_the_number_of_threads_changes_no_weight(three_threads):
    together = trained(200)[0].weight
    with held_to(1):
        assert torch.equal(together, trained(200)[0].weight)


def test_threads_are_given_back_where_a_step_fails(three_threads):
    module = nn.Linear(2, 2)
    learner = Learner(module, lambda x: module(x).sum(), FitSettings(9, 1, 1e-2))

    def fail(*_):
        raise RuntimeError("no step")

    learner.optimiser.register_step_pre_hook(fail)
    with pytest.raises(RuntimeError, match="no step"):
        learner.update(torch.ones(5, 2))
    assert torch.get_num_threads() == 3


def test_gathered_segments_are_those_of_their_numbers():
    q, p = torch.randn(6, 2, 3, 2), torch.randn(6, 2, 3, 2)
    start = PhaseState(torch.randn(6, 3, 2), torch.randn(6, 3, 2))
    params = Parameters(torch.rand(6), torch.rand(6, 3))
    index = torch.tensor([4, 0, 4])
    for momenta in (p, None):
        cut = Segments(start, params, q, momenta, 0.1, 1)[index]
        assert torch.equal(cut.start.q, start.q[index]) and torch.equal(cut.q, q[index])
        assert torch.equal(cut.params.mass, params.mass[index])
        assert cut.p is None if momenta is None else torch.equal(cut.p, p[index])
