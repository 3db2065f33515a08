"""A pair law's fused rollout with a way back, against its twin in plain torch."""

from __future__ import annotations

import pytest
import torch

from dynamics import HEADS, Parameters, PhaseState, build
from dynamics.compiled import unrolled_orbits
from dynamics.compiled.orbits import LANES
from dynamics.compiled.unrolled_orbits import plainly, unrolled
from dynamics.potentials import DisplacementPotential
from loops.threads import held_to
from tests.dynamics.test_unrolled import close, fused
from vidphys.training.ensemble import Ensemble

STORED, EVERY, DT = 2, 3, 0.02


def case(episodes=40, bodies=3, width=40, dtype=torch.float64):
    """A law, its episodes and what they are told, as :func:`unrolled` takes them."""
    torch.manual_seed(2)
    law = DisplacementPotential(2, width, "tanh").to(dtype)
    told = torch.rand(episodes, bodies + bodies * (bodies - 1) // 2, dtype=dtype) + 0.5
    start = torch.randn(episodes, 4 * bodies, dtype=dtype).requires_grad_()
    return law, start, told


def weights_of(law):
    return [w for name, w in law.named_parameters() if name != "phi.layers.2.bias"]


def twin(law, start, told):
    given = (x.unsqueeze(0) for x in (start, told, *weights_of(law)))
    return plainly((STORED, EVERY, DT), *given).squeeze(0)


SIZES = [
    pytest.param({}, marks=pytest.mark.slow),
    {"episodes": 32, "bodies": 2, "width": 64},
    {"episodes": 3, "bodies": 2, "width": 4},  # also quick where the loops are not compiled
]


@pytest.mark.parametrize("sizes", SIZES)
def test_states_and_gradients_are_the_twins(sizes):
    law, start, told = case(**sizes)
    found, wanted = unrolled(law, start, told, STORED, EVERY, DT), twin(law, start, told)
    close(found, wanted)
    upstream = torch.randn_like(found)
    every = [start, *weights_of(law)]
    for one, other in zip(
        torch.autograd.grad(found, every, upstream),
        torch.autograd.grad(wanted, every, upstream),
        strict=True,
    ):
        close(one, other, 1e-11)


def test_second_derivatives_are_those_of_the_function():
    law, start, told = case(episodes=2, bodies=2, width=4)
    assert torch.autograd.gradgradcheck(
        lambda start: unrolled(law, start, told, 1, 2, DT), start, fast_mode=True
    )


def test_a_gradient_of_what_is_told_is_not_left_out():
    law, start, told = case(episodes=5)
    told.requires_grad_()
    whole = unrolled(law, start, told, STORED, EVERY, DT).square().sum()
    other = twin(law, start, told).square().sum()
    close(torch.autograd.grad(whole, told)[0], torch.autograd.grad(other, told)[0])


def test_two_threads_give_what_one_gives():
    law, start, told = case(episodes=100)

    def gradient():
        states = unrolled(law, start, told, STORED, EVERY, DT)
        return torch.autograd.grad(states.square().sum(), weights_of(law)[2])[0]

    alone = gradient()
    with held_to(2):
        both = gradient()
    close(both, alone)


def test_a_start_is_left_as_it_was_however_it_lies():
    law, start, told = case(episodes=LANES)
    across = start.detach().T.contiguous().T
    unrolled(law, across, told, STORED, EVERY, DT)
    assert torch.equal(across, start)


def head_and_start(episodes, name="factored"):
    torch.manual_seed(4)
    head = build(HEADS[name], bodies=3, dt=0.01)
    start = PhaseState(*torch.randn(2, episodes, 3, 2))
    return head, start, Parameters(torch.rand(episodes), 1 + torch.rand(episodes, 3))


def test_a_pair_law_trains_through_it_whatever_the_batch():
    head, start, params = head_and_start(12)
    node = unrolled_orbits._Unrolled
    split = start.map(lambda x: x.unflatten(0, (3, 4)))
    law = params.map(lambda x: x.unflatten(0, (3, 4)))
    found = head.trajectory(split, law, 6, 0.01, 3).states
    wanted = head.plain_trajectory(start, params, 6, 0.01, 3).states
    close(found.flat.flatten(0, 1), wanted.flat, 1e-6)
    assert fused(found, node)
    assert not fused(wanted, node)


@pytest.mark.parametrize("name", ["factored-radial", "factored-learned-kinetic", "symplectic"])
def test_what_the_loops_do_not_know_is_left_to_torch(name):
    head, start, params = head_and_start(12, name)
    found = head.trajectory(start, params, 6, 0.01, 3).states
    assert not fused(found, unrolled_orbits._Unrolled)


def test_members_of_an_ensemble_train_as_they_would_alone():
    heads = [head_and_start(12)[0] for _ in range(2)]
    with torch.no_grad():
        for parameter in heads[1].parameters():
            parameter.mul_(1.3)
    _, start, params = head_and_start(12)

    def loss(head, start):
        return head.trajectory(start, params, 4, 0.01, 2).states.flat.square().mean()

    both = PhaseState(*(torch.stack([x, 0.9 * x]) for x in (start.q, start.p)))
    together = Ensemble(heads)
    losses = together.map(loss, both)
    assert fused(PhaseState(*losses[None, None].expand(2, 1, 2)), unrolled_orbits._Unrolled)
    losses.sum().backward()
    for i, head in enumerate(heads):
        loss(head, both[i]).backward()
        for name, parameter in head.named_parameters():
            if parameter.grad is not None:
                stacked = together.weights[name.replace(".", "/")].grad[i]
                close(stacked, parameter.grad, 1e-5)
