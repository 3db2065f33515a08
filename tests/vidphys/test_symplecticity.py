"""A latent is a phase space where its map to the state is canonical, and only there."""

import pytest
import torch

from dynamics import PhaseState
from vidphys.symplecticity import symplecticity


@pytest.fixture
def states():
    rng = torch.Generator().manual_seed(0)
    q, p = torch.randn(2, 900, 3, 2, generator=rng, dtype=torch.float64)
    return PhaseState(q, p)


def measured(states, latent):
    return symplecticity(latent[:700], states[:700], latent[700:], states[700:])


def kicked(states):
    """p + dV/dq of a cubic V: canonical, and not linear."""
    return PhaseState(states.q, states.p + 0.3 * states.q.square())


@pytest.mark.parametrize("change", [lambda s: s, kicked], ids=["same", "kicked"])
def test_a_canonical_map_of_the_state_is_symplectic(states, change):
    found = measured(states, 3 * change(states).flat)
    assert found.holds
    assert found.r2 > 1 - 1e-9 and found.deviation < 1e-8


def test_a_latent_of_which_a_body_has_another_scale_is_not(states):
    p = states.p.clone()
    p[:, 0] *= 3
    found = measured(states, PhaseState(states.q, p).flat)
    assert found.r2 > 1 - 1e-9
    # brackets are (1/3, 1, 1), of which 7/9 is the common scale
    missed = (2 * (4 / 9) ** 2 + 4 * (2 / 9) ** 2) ** 0.5
    expected = missed / (6**0.5 * 7 / 9)
    assert found.deviation == pytest.approx(expected, rel=1e-6)
    assert not found.holds


def test_a_latent_without_the_momenta_explains_half_and_does_not_hold(states):
    rng = torch.Generator().manual_seed(1)
    noise = torch.randn(states.p.shape, generator=rng, dtype=torch.float64)
    found = measured(states, PhaseState(states.q, noise).flat)
    assert 0.3 < found.r2 < 0.6 and not found.holds


@pytest.mark.parametrize(("width", "count"), [(11, 900), (12, 60)])
def test_what_cannot_be_measured_is_refused(states, width, count):
    with pytest.raises(ValueError, match="symplecticity"):
        symplecticity(states.flat[:count, :width], states[:count], states.flat[:, :width], states)
