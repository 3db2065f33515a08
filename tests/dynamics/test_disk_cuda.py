"""Displacements into the disk and slopes back by Triton's kernels, in its interpreter."""

import pytest
import torch

from dynamics import engines
from dynamics.potentials import DisplacementPotential
from loops import has_triton
from tests.shared.kernels import apart, interpreted

needs_triton = pytest.mark.skipif(not has_triton(), reason="triton is not installed")
START = """
import copy
import torch
from torch.autograd import grad
from dynamics.compiled.disk_cuda import pair_gradient
from dynamics.potentials import REACH, SPREAD, DisplacementPotential, soft_length, unsquashed
from tests.dynamics.test_fused_gradient import close
from tests.shared.graphs import goes_through

torch.manual_seed(0)

def displacements(rows):  # of every size, from none to far beyond the reach
    x = torch.randn(rows, 2) * 10.0 ** torch.linspace(-4, 4, rows)[:, None]
    x[0] = 0
    return x.requires_grad_()

def wide(x):
    return x.detach().double().requires_grad_()

def law_and_wide():
    law = DisplacementPotential(2, 16, "tanh")
    return law, copy.deepcopy(law).double()

def by_kernels(law, x):
    return pair_gradient(law.phi.gradient, x)

def weights(law):
    return list(law.phi.parameters())[:-1]  # but for the last bias, on which nothing depends
"""


@needs_triton
def test_the_map_and_its_way_back_are_the_twin_s_at_every_distance():
    """Row by row, of slopes along the displacement and across it.

    Of what goes along little is left far out; that little is right to its own size.
    """
    interpreted(
        START
        + """
def alike(found, wanted, size):
    wrong = (found - wanted).detach()
    assert (wrong.abs() <= 4e-6 * size).all(), (wrong.abs() / size).nan_to_num().max()
    return (wrong * at).sum(-1).abs(), (wanted * at).sum(-1).abs()

x = displacements(300)
at = wide(x)
u = SPREAD * at / (REACH + soft_length(at))
shrink = 1 / (REACH + soft_length(at)).detach()
along = x.detach() / 2.0 ** x.detach().norm(dim=-1, keepdim=True).clamp(min=1e-9).log2().round()
along[0] = 0.5
across = along.flip(-1) * torch.tensor([-1, 1])
for one, upstream in ((i, j) for i in (along, across) for j in (along, across)):
    inputs = []
    slopes = torch.stack([one, -0.5 * one]).requires_grad_()
    found = pair_gradient(lambda rows: inputs.append(rows) or slopes, x)
    sides = wide(slopes)
    wanted = unsquashed(SPREAD / 2 * (sides[0] - sides[1]), at, soft_length(at))
    back = grad(found, [slopes, x], upstream)
    true = grad(wanted, [sides, at], upstream.double())
    alike(back[0], true[0], shrink)
    ahead = alike(found, wanted, shrink), alike(back[1], true[1], shrink**2)
    if one is upstream is along:
        assert all((wrong <= 4e-6 * size).all() for wrong, size in ahead)
    alike(inputs[0], torch.stack([u, -u]), at.abs() * shrink)
    (back,) = grad(inputs[0], x, slopes)
    (true,) = grad(torch.stack([u, -u]), at, sides, retain_graph=True)
    alike(back, true, shrink)
"""
    )


@pytest.mark.slow
@needs_triton
def test_a_law_s_force_and_gradients_are_those_of_double_precision():
    """To what is left of the network's slopes, which nearly cancel at u and -u."""
    interpreted(
        START
        + """
law, twin = law_and_wide()
x = displacements(150)
at, upstream = wide(x), torch.randn(150, 2)
found, wanted = by_kernels(law, x), twin.plain_pair_gradient(at)
close(found, wanted, 2e-5)
back = grad(found, [x, *weights(law)], upstream)
true = grad(wanted, [at, *weights(twin)], upstream.double())
for one, other in zip(back, true, strict=True):
    close(one, other, 2e-5)
with torch.no_grad():
    again = by_kernels(law, x.view(5, 30, 2))
assert torch.equal(again.view(150, 2), found) and not again.requires_grad
"""
    )


@pytest.mark.slow
@needs_triton
def test_models_side_by_side_have_the_gradients_that_they_have_alone():
    interpreted(
        START
        + """
from vidphys.training.ensemble import Ensemble

laws = [law_and_wide()[0] for _ in range(3)]
x = torch.randn(3, 20, 2, requires_grad=True)
ensemble = Ensemble(laws)
found = ensemble.map(by_kernels, x)
found.square().sum().backward()
on_weights = ensemble.weights["phi/layers/0/weight"].grad
for i, law in enumerate(laws):
    at = x[i].detach().requires_grad_()
    alone = by_kernels(law, at)
    close(found[i], alone, 1e-6)
    on_x, on_weight = grad(alone.square().sum(), [at, weights(law)[0]])
    close(x.grad[i], on_x, 1e-6)
    close(on_weights[i], on_weight, 1e-6)
"""
    )


@pytest.mark.slow
@needs_triton
def test_a_derivative_of_the_way_back_is_the_twin_s():
    """Of both maps: of forces that depend on places alone, and on the weights too."""
    interpreted(
        START
        + """
def twice(force, x, law):
    (once,) = grad(force(x).square().sum(), x, create_graph=True)
    return grad(once.square().sum(), [x, *weights(law)])

law, twin = law_and_wide()
x = torch.randn(40, 2, requires_grad=True)
found = twice(lambda d: by_kernels(law, d), x, law)
for one, other in zip(found, twice(twin.plain_pair_gradient, wide(x), twin), strict=True):
    close(one, other, 1e-5)
"""
    )


@needs_triton
def test_a_law_asks_the_kernels_on_a_card_where_they_know_its_displacements():
    """A card is stood in for by the CPU, where the kernels are interpreted."""
    interpreted(
        START
        + """
from unittest import mock
from torch.func import functional_call, stack_module_state, vmap

class Force(torch.nn.Module):
    def __init__(self, law):
        super().__init__()
        self.law = law

    def forward(self, x):
        return self.law.pair_gradient(x)

def asked(x, space=2):
    return goes_through(DisplacementPotential(space, 16, "tanh").pair_gradient(x), "_Turned")

x = torch.randn(5, 3, 2, requires_grad=True)
assert not asked(x)
with mock.patch("dynamics.engines._on_card", lambda _: True):
    assert asked(x) and asked(x[0, 0])
    assert not asked(torch.randn(5, 3, requires_grad=True), 3)
    assert not asked(x[:0])
    law, _ = law_and_wide()
    assert not goes_through(law.double().pair_gradient(x.double()), "_Turned")
    forces = [Force(law_and_wide()[0]) for _ in range(2)]
    state, _ = stack_module_state(forces)
    one = lambda weights, d: functional_call(forces[0], weights, d)
    found = vmap(one, (0, None))(state, x)  # displacements that are not mapped over
    (on_x,) = grad(found.sum(), x)
    wanted = sum(grad(force(x).sum(), x)[0] for force in forces)
    close(on_x, wanted, 1e-6)
"""
    )


def test_what_no_engine_knows_is_computed_by_torch_s_operations(monkeypatch):
    law, x = DisplacementPotential(2, 8, "tanh"), torch.randn(4, 2)
    assert engines.pair_gradient(law, x) is None
    known = torch.zeros(4, 2)
    monkeypatch.setattr(DisplacementPotential, "gradient_engine", lambda *_: known)
    assert law.pair_gradient(x) is known
    monkeypatch.setattr(DisplacementPotential, "gradient_engine", lambda *_: None)
    assert torch.equal(law.pair_gradient(x), law.plain_pair_gradient(x))


@needs_triton
def test_the_kernels_are_compiled_for_a_card():
    """For one that is not here."""
    apart("""
from dynamics.compiled import disk_cuda as it
from dynamics.compiled import disk_kernel as kernels
from tests.shared.kernels import shared_bytes

for kernel in (kernels.squash, kernels.turn, kernels.turn_back):
    assert not shared_bytes(kernel, dict(R=it.ROWS), {}, dict(rows="i32", scale="fp32"))
""")
