"""A bath's friction and temperature come out of tracks, whatever the error of their positions."""

import pytest
import torch

from binders import Tracks
from dynamics import Parameters, PhaseState, build, rollout, terms
from vidphys.training.baths import measure_bath

RATE, TEMPERATURE, MASS, INTERVAL = 0.8, 0.3, 1.5, 0.1


@pytest.fixture(scope="module")
def kicked():
    """Many short paths in a trap, long after their start."""
    law = Parameters(torch.ones(256), torch.full((256, 1), MASS))
    law = law.with_scalar("temperature", TEMPERATURE)
    trap = terms.Hamiltonian(potentials=(terms.Trap(4.0),), ports=(terms.ConstantBath(RATE),))
    head, still = build(trap, 1, 0.02), PhaseState(torch.zeros(256, 1, 2), torch.zeros(256, 1, 2))
    path = rollout(head, still, law, 1000, 0.02, every=5, seed=1).states.q[:, 100:]
    return head, path, law


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_friction_and_temperature_are_those_of_the_kicks(kicked, noise):
    head, path, law = kicked
    seen = path + noise * torch.randn(path.shape, generator=torch.Generator().manual_seed(0))
    tracks = Tracks(seen, torch.ones(seen.shape[:-1]), INTERVAL * torch.arange(path.shape[1]))
    found = measure_bath(head, tracks, law, INTERVAL)
    assert found.rate == pytest.approx(RATE, rel=0.1)
    assert found.temperature == pytest.approx(TEMPERATURE, rel=0.1)


def test_what_few_frames_do_not_tell_is_left_to_others(kicked):
    head, path, law = kicked
    tracks = Tracks(path[:, :8], torch.ones(256, 8, 1), INTERVAL * torch.arange(8))
    found = measure_bath(head, tracks, law, INTERVAL, rate=RATE)
    assert (found.rate, found.temperature) == (None, None)
