"""Laws of few numbers come out of noisy frames without the bias that short windows have."""

import numpy as np
import pytest
import torch

from binders import Tracks
from dynamics import Parameters, PhaseState, build, rollout, terms
from vidphys.training.few import fit_few, is_few, last_state

LAW = Parameters(torch.ones(1).double(), torch.ones(1, 1).double())


def swing(rate2, friction):
    law = terms.Hamiltonian(potentials=(terms.Pendulum(rate2),), ports=(terms.Drag(rate=friction),))
    return terms.OnArc((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), law)


def seen(noise=0.01, lost=()):
    """A pendulum that swings far, at a rate near one in these units."""
    head = build(swing(1.0, 0.03), 1, 0.01).double()
    start = PhaseState(*torch.tensor([[[[0.0, 0.0]]], [[[1.6, 0.0]]]], dtype=torch.float64))
    path = rollout(head, start, LAW, 1500, 0.01, every=5).states.q
    noisy = path + noise * torch.from_numpy(np.random.default_rng(0).standard_normal(path.shape))
    sure = torch.ones(path.shape[:-1])
    for frame in lost:
        noisy[:, frame], sure[:, frame] = 0.0, 0.0
    return Tracks(noisy, sure, 0.05 * torch.arange(path.shape[1])), path


@pytest.mark.parametrize("lost", [(), pytest.param(tuple(range(70, 110)), marks=pytest.mark.slow)])
def test_numbers_are_found_from_noisy_frames_also_where_some_are_missing(lost):
    tracks, path = seen(lost=lost)
    head = build(swing(1.2, 0.1), 1, 0.01)
    assert is_few(head)
    fit_few(head, tracks, LAW.map(torch.Tensor.float), 0.05, 8)
    friction = torch.nn.functional.softplus(head.law.ports[0].raw).item()
    assert head.law.potential.rate2.item() == pytest.approx(1.0, rel=5e-3)
    assert friction == pytest.approx(0.03, abs=3e-3)
    last = last_state(head, tracks, LAW.map(torch.Tensor.float), 0.05)
    assert float((last.q - path[:, -1]).abs().max()) < 0.01  # half of one position's noise
    assert last.q.dtype == torch.float32
