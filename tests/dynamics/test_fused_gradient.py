"""The fused input gradient against its twin in plain torch: values and derivatives."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import nn
from torch.func import functional_call, stack_module_state, vmap

from dynamics import HEADS, build
from dynamics.compiled import gradient
from dynamics.compiled.gradient import input_gradient
from dynamics.compiled.memory import Kept
from dynamics.compiled.panels import ROWS
from dynamics.compiled.twin import plain_gradient
from dynamics.mlp import MLP
from loops.threads import held_to
from tests.shared.graphs import goes_through
from vidphys.training.ensemble import Ensemble

ROUNDING = {torch.float32: 2e-6, torch.float64: 1e-13}


def case(rows, inputs, width, dtype=torch.float64):
    """Rows and the weights of a network, all to be differentiated."""
    network = MLP((inputs, width, width, 1)).to(dtype)
    weights = [w.detach().requires_grad_() for w in list(network.parameters())[:-1]]
    return torch.randn(rows, inputs, dtype=dtype, requires_grad=True), *weights


def close(found, wanted, tolerance):
    assert (found - wanted).abs().max() <= tolerance * wanted.abs().max()


@pytest.mark.parametrize(
    ("rows", "inputs", "width", "dtype"),
    [(200, 2, 64, torch.float32), (70, 3, 40, torch.float64), (1, 2, 32, torch.float64)],
)
def test_values_and_gradients_are_the_twins(rows, inputs, width, dtype):
    given = case(rows, inputs, width, dtype)
    found, wanted = input_gradient(*given), plain_gradient(*given)
    close(found, wanted, ROUNDING[dtype])
    upstream = torch.randn_like(found)
    pairs = zip(
        torch.autograd.grad(found, given, upstream),
        torch.autograd.grad(wanted, given, upstream),
        strict=True,
    )
    for one, other in pairs:
        close(one, other, ROUNDING[dtype])


def test_first_and_second_derivatives_are_those_of_the_function():
    given = case(5, 2, 32)
    assert torch.autograd.gradcheck(input_gradient, given, fast_mode=True)
    assert torch.autograd.gradgradcheck(input_gradient, given, fast_mode=True)


def test_several_calls_before_one_way_back_keep_their_own_memory():
    given = case(64, 2, 32)

    def twice(function):
        once = function(*given)
        return function(once, *given[1:]) * function(-once, *given[1:])

    for _ in range(2):  # the second time in memory that was used before
        found = torch.autograd.grad(twice(input_gradient).sum(), given)
        wanted = torch.autograd.grad(twice(plain_gradient).sum(), given)
        for one, other in zip(found, wanted, strict=True):
            close(one, other, 1e-12)


def test_two_threads_give_what_one_gives():
    given = case(300, 2, 32)
    alone = torch.autograd.grad(input_gradient(*given).square().sum(), given)
    with held_to(2):
        both = torch.autograd.grad(input_gradient(*given).square().sum(), given)
    for one, other in zip(both, alone, strict=True):
        close(one, other, 1e-13)


def test_without_a_way_back_nothing_is_kept(monkeypatch):
    given = case(2_000, 2, 32)
    sizes = []
    monkeypatch.setattr(
        gradient, "Kept", lambda shape, dtype: sizes.append(shape) or Kept(shape, dtype)
    )
    with torch.no_grad():
        alone = input_gradient(*given)
    assert torch.equal(alone, input_gradient(*given).detach())
    tiles = [shape[2] for shape in sizes]
    assert tiles == [1, -(-2_000 // ROWS)]


def test_threads_that_keep_nothing_do_not_share_memory():
    given = [x.detach() for x in case(20_000, 2, 64)]
    alone = input_gradient(*given)
    with held_to(4):
        together = [input_gradient(*given) for _ in range(5)]
    for each in together:
        assert torch.equal(each, alone)


def test_models_side_by_side_have_the_gradients_that_they_have_alone():
    networks = [MLP((2, 32, 32, 1)) for _ in range(3)]
    x = torch.randn(3, 80, 2)
    weights, _ = stack_module_state(networks)

    def one(state, rows):
        return functional_call(
            _Gradient(networks[0]), {f"network.{k}": v for k, v in state.items()}, rows
        )

    vmap(one)(weights, x).square().sum().backward()
    for i, (network, rows) in enumerate(zip(networks, x, strict=True)):
        network.plain_gradient(rows).square().sum().backward()
        for name, parameter in network.named_parameters():
            if parameter.grad is not None:
                close(weights[name].grad[i], parameter.grad, 1e-5)


class _Gradient(nn.Module):
    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, x):
        return self.network.gradient(x)


def fused(network, rows=100, dtype=torch.float32):
    return goes_through(network.to(dtype).gradient(torch.randn(rows, 2, dtype=dtype)), "_Gradient")


def test_many_rows_of_a_tanh_network_in_single_precision_are_fused_and_nothing_else():
    assert fused(MLP((2, 32, 32, 1)))
    assert not fused(MLP((2, 32, 32, 1)), rows=10)
    assert not fused(MLP((2, 32, 32, 1)), dtype=torch.float64)
    assert not fused(MLP((2, 32, 32, 1), "softplus"))
    assert not fused(MLP((2, 32, 32, 32, 1)))


def test_an_ensemble_of_heads_trains_through_the_fused_gradient():
    heads = [build(HEADS["factored"].throughout(width=32), bodies=3, dt=0.002) for _ in range(2)]
    ensemble = Ensemble(heads)
    q = torch.randn(2, 30, 3, 2)
    loss = ensemble.map(lambda head, x: head.potential.pair_gradient(x).square().sum(), q).sum()
    loss.backward()
    wanted = torch.zeros(())
    for head, x in zip(heads, q, strict=True):
        head.double()
        wanted = wanted + head.potential.pair_gradient(x.double()).square().sum()
    wanted.backward()
    found = ensemble.weights["potential/phi/layers/1/weight"].grad
    close(found[1], heads[1].potential.phi.layers[1].weight.grad.float(), 1e-5)


def test_the_way_back_is_the_same_whichever_thread_is_first():
    given = case(4096, 2, 32, torch.float32)
    with held_to(4):
        upstream = torch.ones(4096, 2)
        found = {
            torch.autograd.grad(input_gradient(*given), given[1], upstream)[0].numpy().tobytes()
            for _ in range(40)
        }
    assert len(found) == 1


def test_outputs_without_a_way_back_are_torch_s_own():
    torch.manual_seed(2)
    network = MLP((3, 20, 20, 1))
    x = torch.randn(5, 301, 3)
    with torch.no_grad():
        found = network(x)
    expected = copy.deepcopy(network).double().plain_forward(x.double())
    assert found.shape == (5, 301, 1) and not found.requires_grad
    torch.testing.assert_close(found, expected.detach().float(), rtol=1e-6, atol=1e-6)
    assert torch.equal(network(x), network.plain_forward(x.reshape(-1, 3)).reshape(5, 301, 1))
