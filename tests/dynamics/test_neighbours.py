"""Pairs within reach against all pairs."""

import pytest
import torch

from dynamics import PairLaw, Parameters
from dynamics.contact import CutSpring
from dynamics.neighbours import WithinReach
from dynamics.potentials import SoftenedGravity


def crowd(box: float | None = None) -> tuple[torch.Tensor, Parameters]:
    rng = torch.Generator().manual_seed(0)
    q = 3 * torch.randn(2, 40, 2, generator=rng, dtype=torch.float64)
    mass = 1 + torch.rand(2, 40, generator=rng, dtype=torch.float64)
    return q, Parameters(torch.tensor([1.0, -0.5], dtype=torch.float64), mass)


@pytest.mark.parametrize("box", [None, 5.0])
def test_a_law_of_finite_range_loses_nothing(box):
    q, params = crowd()
    whole = CutSpring(1.3, PairLaw(box=box))
    near = WithinReach(whole, 1.3)
    torch.testing.assert_close(
        near.force(q, params), whole.force(q, params), rtol=1e-14, atol=1e-14
    )
    torch.testing.assert_close(
        near.energy(q, params), whole.energy(q, params), rtol=1e-14, atol=1e-14
    )


def test_the_force_is_minus_the_gradient_of_the_shifted_energy():
    q, params = crowd()
    near = WithinReach(SoftenedGravity(0.1), 2.0)
    q.requires_grad_()
    (slope,) = torch.autograd.grad(near.energy(q, params).sum(), q)
    torch.testing.assert_close(near.force(q.detach(), params), -slope, rtol=1e-14, atol=1e-14)


def test_the_energy_of_a_pair_is_counted_from_that_at_the_reach():
    q = torch.tensor([[0.0, 0.0], [1.5, 0.0]]).double()
    params = Parameters(torch.ones(()).double(), torch.ones(2).double())
    energy = WithinReach(SoftenedGravity(0.1), 2.0).energy(q, params)
    assert float(energy) == pytest.approx(4.01**-0.5 - 2.26**-0.5, rel=3e-15)


def test_a_reach_over_all_bodies_is_all_pairs():
    q, params = crowd()
    whole = SoftenedGravity(0.1)
    torch.testing.assert_close(
        WithinReach(whole, 1e3).force(q, params), whole.force(q, params), rtol=1e-14, atol=1e-14
    )


@pytest.mark.parametrize("reach", [0.0, -1.0, float("inf")])
def test_an_impossible_reach_is_refused(reach):
    with pytest.raises(ValueError, match="reach must be a positive distance"):
        WithinReach(SoftenedGravity(0.1), reach)


def test_a_reach_that_meets_an_image_is_refused():
    with pytest.raises(ValueError, match="meets a body and its image"):
        WithinReach(CutSpring(3.0, PairLaw(box=5.0)), 2.5)
