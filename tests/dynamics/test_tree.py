"""Far groups taken as one, against all pairs."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics import PairLaw, Parameters
from dynamics.contact import CutSpring
from dynamics.potentials import SoftenedGravity
from dynamics.tree import LEAF, BarnesHut

WHOLE = SoftenedGravity(0.1)


def crowd(count: int, space: int = 2, seed: int = 0) -> tuple[torch.Tensor, Parameters]:
    rng = torch.Generator().manual_seed(seed)
    q = count**0.5 * torch.randn(2, count, space, generator=rng, dtype=torch.float64)
    mass = 1 + torch.rand(2, count, generator=rng, dtype=torch.float64)
    return q, Parameters(torch.tensor([1.0, -0.5], dtype=torch.float64), mass)


def off(found: torch.Tensor, truth: torch.Tensor) -> float:
    """Root mean square error over that of the truth."""
    return float((found - truth).norm() / truth.norm())


@settings(max_examples=25, deadline=None)
@given(
    count=st.integers(1, 20 * LEAF),
    space=st.integers(1, 3),
    seed=st.integers(0, 2**16),
    together=st.booleans(),
)
def test_no_angle_is_all_pairs(count, space, seed, together):
    q, params = crowd(count, space, seed)
    if together:
        q[:, : count // 2] = q[:, :1]
    tree = BarnesHut(WHOLE, 0.0)
    torch.testing.assert_close(
        tree.force(q, params), WHOLE.force(q, params), rtol=1e-12, atol=1e-11
    )
    torch.testing.assert_close(tree.energy(q, params), WHOLE.energy(q, params), rtol=1e-12, atol=0)


def test_a_smaller_angle_errs_less_and_half_a_radian_by_little():
    q, params = crowd(1000)
    force, energy = WHOLE.force(q, params), WHOLE.energy(q, params)
    trees = [BarnesHut(WHOLE, angle) for angle in (1.0, 0.5, 0.25)]
    wide, half, narrow = (off(tree.force(q, params), force) for tree in trees)
    assert 0 < narrow < 0.5 * half < 0.25 * wide
    assert half < 0.003
    assert off(trees[1].energy(q, params), energy) < 5e-3


def test_a_far_group_acts_from_the_centre_of_its_masses():
    away = torch.tensor([[10.0, 1.0], [10.0, -1.0]]).double().repeat(LEAF // 2, 1)
    q = torch.cat([torch.zeros(LEAF, 2).double(), away])
    mass = torch.tensor([1e-12] * LEAF + [3.0, 1.0] * (LEAF // 2), dtype=torch.float64)
    law = Parameters(torch.ones(()).double(), mass)
    each, one = (BarnesHut(WHOLE, angle).force(q, law)[0] for angle in (0.0, 0.5))
    pull = 2e-12 * LEAF * (100.0 + 0.5**2 + 0.1**2) ** -1.5
    torch.testing.assert_close(one, pull * torch.tensor([10.0, 0.5]).double(), rtol=1e-9, atol=0)
    assert off(one, each) > 1e-3


def test_amounts_of_both_signs_act_from_the_centre_of_their_sizes():
    q, params = crowd(400)
    signs = torch.tensor([1.0, -1.0]).double().repeat(200)
    law = Parameters(params.coupling, params.mass * signs)
    assert off(BarnesHut(WHOLE, 0.25).force(q, law), WHOLE.force(q, law)) < 3e-3


def test_what_is_moved_or_counted_otherwise_is_forced_alike():
    q, params = crowd(300)
    tree, other = BarnesHut(WHOLE, 0.5), torch.randperm(300)
    force = tree.force(q, params)
    counted = Parameters(params.coupling, params.mass[:, other])
    torch.testing.assert_close(tree.force(q[:, other], counted), force[:, other])
    torch.testing.assert_close(tree.force(q + 7.0, params), force, rtol=1e-6, atol=1e-6)


def test_momentum_is_kept_as_far_as_forces_are_exact():
    q, params = crowd(1000)
    force = BarnesHut(WHOLE, 0.5).force(q, params)
    assert float(force.sum(1).norm()) < 1e-2 * float(force.norm(dim=-1).sum())


def test_gradients_are_those_of_what_was_computed():
    q, params = crowd(20 * LEAF)
    q = q[0].requires_grad_()
    law = Parameters(params.coupling[0], params.mass[0])
    tree = BarnesHut(WHOLE, 0.7)
    (slope,) = torch.autograd.grad(tree.energy(q, law), q)
    step = 1e-6 * torch.randn(q.shape, generator=torch.Generator().manual_seed(1)).double()
    with torch.no_grad():
        rise = tree.energy(q + step, law) - tree.energy(q - step, law)
    assert float(rise) == pytest.approx(2 * float((slope * step).sum()), rel=1e-6)


def test_single_precision_is_as_good_as_its_forces():
    q, params = crowd(1000)
    tree = BarnesHut(WHOLE, 0.5)
    single = tree.force(q.float(), params.map(lambda x: x.float()))
    assert single.dtype == torch.float32
    assert off(single.double(), tree.force(q, params)) < 1e-3


@pytest.mark.parametrize("angle", [-0.1, 1.5, float("nan")])
def test_an_impossible_angle_is_refused(angle):
    with pytest.raises(ValueError, match="opening angle must be in"):
        BarnesHut(WHOLE, angle)


def test_a_periodic_box_is_refused():
    with pytest.raises(ValueError, match="periodic box has no tree"):
        BarnesHut(CutSpring(3.0, PairLaw(box=5.0)), 0.5)
