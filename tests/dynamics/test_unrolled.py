"""A residual map's fused rollout with a way back, against its twin in plain torch."""

from __future__ import annotations

import pytest
import torch

from dynamics import HEADS, Parameters, PhaseState, build
from dynamics.compiled.residual import net_of
from dynamics.compiled.unrolled import _Unrolled, plainly, unrolled
from dynamics.mlp import MLP, SILU
from dynamics.unstructured import ResidualMap
from loops.threads import held_to
from vidphys.training.ensemble import Ensemble

STORED, EVERY = 2, 3


def case(rows=70, entries=6, conditions=2, width=40, dtype=torch.float64):
    """A map's sizes, its rows and its weights, as :func:`unrolled` takes them."""
    torch.manual_seed(2)
    network = MLP((entries + conditions, width, width, width, entries), SILU).to(dtype)
    given = torch.randn(rows, entries), torch.randn(rows, conditions)
    return network, torch.rand(entries, dtype=dtype), *(x.to(dtype).requires_grad_() for x in given)


def twin(network, scale, start, known):
    weights = [w.unsqueeze(0) for w in network.parameters()]
    rows = torch.cat([start, known], -1).unsqueeze(0)
    return plainly((STORED, EVERY), scale.unsqueeze(0), rows, *weights).squeeze(0)


def close(found, wanted, tolerance=1e-12):
    assert (found - wanted).abs().max() <= tolerance * wanted.abs().max()


@pytest.mark.parametrize(
    "sizes",
    [
        pytest.param({}, marks=pytest.mark.slow),
        {"rows": 130, "entries": 36, "conditions": 5, "width": 32},
    ],
)
def test_states_and_gradients_are_the_twins(sizes):
    network, *given = case(**sizes)
    found, wanted = unrolled(network, *given, STORED, EVERY), twin(network, *given)
    close(found, wanted)
    upstream = torch.randn_like(found)
    every = [*given[1:], *network.parameters()]
    for one, other in zip(
        torch.autograd.grad(found, every, upstream),
        torch.autograd.grad(wanted, every, upstream),
        strict=True,
    ):
        close(one, other)


@pytest.mark.parametrize(("inputs", "outputs"), [(8, 6), (70, 6), (8, 100)])
def test_there_is_a_bias_of_zero_for_every_panel_that_is_asked_for(inputs, outputs):
    """The loops read it unchecked: a missing panel would be whatever lies behind in memory."""
    layers = MLP((inputs, 32, 32, outputs), SILU).layers
    net = net_of(
        *([x.detach().numpy() for x in xs] for xs in zip(*map(_both, layers), strict=True))
    )
    assert len(net.none) >= max(len(net.into), len(net.out), net.biases.shape[1])


def _both(layer):
    return layer.weight, layer.bias


def test_second_derivatives_are_those_of_the_function():
    network, scale, *given = case(rows=2, entries=2, conditions=1, width=4)
    assert torch.autograd.gradgradcheck(
        lambda start, known: unrolled(network, scale, start, known, 1, 2), given, fast_mode=True
    )


def test_a_gradient_of_the_sizes_is_not_left_out():
    network, scale, *given = case(rows=5)
    scale.requires_grad_()
    whole = unrolled(network, scale, *given, STORED, EVERY).square().sum()
    other = twin(network, scale, *given).square().sum()
    close(torch.autograd.grad(whole, scale)[0], torch.autograd.grad(other, scale)[0])


def test_two_threads_give_what_one_gives():
    network, *given = case(rows=300)

    def gradient():
        states = unrolled(network, *given, STORED, EVERY)
        return torch.autograd.grad(states.square().sum(), network.layers[1].weight)[0]

    alone = gradient()
    with held_to(2):
        both = gradient()
    close(both, alone)


def head_and_start(rows):
    head = build(HEADS["unstructured"], bodies=3, dt=0.01)
    head.set_scale(0.02, 0.1)
    start = PhaseState(*torch.randn(2, rows, 3, 2))
    return head, start, Parameters(torch.rand(rows), 1 + torch.rand(rows, 3))


def fused(states, by=_Unrolled):
    node, seen = states.q.grad_fn, set()
    while node is not None and node not in seen:
        seen.add(node)
        if type(node) is by._backward_cls:
            return True
        node = node.next_functions[0][0] if node.next_functions else None
    return False


def test_a_map_trains_through_it_where_there_are_rows_enough():
    head, start, params = head_and_start(80)
    found = head.trajectory(start, params, 6, 0.01, 3).states
    wanted = head.plain_trajectory(start, params, 6, 0.01, 3).states
    close(found.flat, wanted.flat, 1e-6)
    assert fused(found)
    assert not fused(wanted)
    few = head.trajectory(start[:10], params[:10], 6, 0.01, 3).states
    assert not fused(few)


def test_models_side_by_side_have_the_gradients_that_they_have_alone():
    heads = [head_and_start(64)[0] for _ in range(2)]
    _, start, params = head_and_start(64)

    def loss(head: ResidualMap, q, p):
        states = head.trajectory(PhaseState(q, p), params, 4, 0.01, 2).states
        return states.q.square().sum() + states.p.square().sum()

    ensemble = Ensemble(heads)
    q, p = (torch.stack([x, -x]) for x in (start.q, start.p))
    ensemble.map(loss, q, p).sum().backward()
    for i, head in enumerate(heads):
        loss(head, q[i], p[i]).backward()
        for name, parameter in head.named_parameters():
            close(ensemble.weights[name.replace(".", "/")].grad[i], parameter.grad, 1e-5)
