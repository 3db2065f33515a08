"""The input gradient of a network by Triton's kernels, in its interpreter, against torch's own."""

import pytest

from loops import has_triton
from tests.shared.kernels import apart, interpreted

pytestmark = pytest.mark.skipif(not has_triton(), reason="triton is not installed")
START = """
import torch
from dynamics.compiled.twin import plain_gradient
from dynamics.compiled.network_cuda import input_gradient
from tests.dynamics.test_fused_gradient import case, close

torch.manual_seed(0)  # a process of its own: nothing else has set it

def wide(x):
    return x.detach().double().requires_grad_()
"""


@pytest.mark.parametrize(
    ("rows", "width"),
    [(70, 24), *(pytest.param(*x, marks=pytest.mark.slow) for x in ((16, 128), (5, 16)))],
)
def test_values_and_gradients_are_the_twins(rows, width):
    """Widths that are no power of two, more rows than a program has, and fewer."""
    interpreted(
        START
        + f"""
given = case({rows}, 2, {width}, torch.float32)
exact = [wide(x) for x in given]
found, wanted = input_gradient(*given), plain_gradient(*exact)
close(found, wanted, 2e-6)
upstream = torch.randn({rows}, 2)
back = torch.autograd.grad(found, given, upstream)
for one, other in zip(back, torch.autograd.grad(wanted, exact, upstream.double()), strict=True):
    close(one, other, 2e-6)
again = torch.autograd.grad(input_gradient(*given), given, upstream)
assert all(torch.equal(*pair) for pair in zip(back, again, strict=True))
with torch.no_grad():
    assert torch.equal(input_gradient(*given), found)
"""
    )


def test_what_comes_from_above_may_be_of_any_size():
    """Also of very different sizes in different rows, as where two bodies of one episode meet."""
    interpreted(
        START
        + """
given = case(40, 2, 32, torch.float32)
exact = [wide(x) for x in given]
upstream = torch.randn(40, 2) * 10.0 ** torch.linspace(-9, 3, 40)[:, None]
back = torch.autograd.grad(input_gradient(*given), given, upstream)
wanted = torch.autograd.grad(plain_gradient(*exact), exact, upstream.double())
for one, other in zip(back[0], wanted[0], strict=True):
    close(one, other, 5e-6)
for one, other in zip(back[1:], wanted[1:], strict=True):
    close(one, other, 2e-6)
none = torch.autograd.grad(input_gradient(*given), given, torch.zeros(40, 2))
assert all(not x.any() for x in none)
"""
    )


@pytest.mark.slow
def test_models_side_by_side_have_the_gradients_that_they_have_alone():
    interpreted(
        START
        + """
cases = [case(20, 2, 16, torch.float32) for _ in range(3)]
together = [torch.stack(parts).detach().requires_grad_() for parts in zip(*cases, strict=True)]
found = torch.func.vmap(input_gradient)(*together)
back = torch.autograd.grad(found.square().sum(), together)
for i, given in enumerate(cases):
    alone = input_gradient(*given)
    close(found[i], alone, 1e-6)
    for one, other in zip(back, torch.autograd.grad(alone.square().sum(), given), strict=True):
        close(one[i], other, 1e-6)
"""
    )


@pytest.mark.slow
def test_a_derivative_of_the_way_back_is_the_twin_s():
    interpreted(
        START
        + """
given = case(16, 2, 16, torch.float32)

def twice(function, parts):
    (once,) = torch.autograd.grad(function(*parts).square().sum(), parts[:1], create_graph=True)
    return torch.autograd.grad(once.square().sum(), parts)

exact = [wide(x) for x in given]
for one, other in zip(twice(input_gradient, given), twice(plain_gradient, exact), strict=True):
    close(one, other, 1e-5)
"""
    )


@pytest.mark.parametrize(
    "width",
    [64, pytest.param(256, marks=pytest.mark.slow), pytest.param(512, marks=pytest.mark.slow)],
)
def test_the_kernels_fit_a_card(width):
    """Compiled for a card that is not here; what a program may share is that of one of a desk."""
    apart(f"""
from dynamics.compiled import network_cuda as it
from dynamics.compiled import network_kernel as kernels
from tests.shared.kernels import shared_bytes

kinds = dict.fromkeys(("rows", "beside", "share", "units"), "i32") | dict(matrix="*fp16")
rows = it.ROW_WISE | dict(BLOCK=64 if {width} <= 256 else 32)
for kernel, sizes in (
    (kernels.forward, rows),
    (kernels.back, rows),
    (kernels.square, it.SQUARE | dict(TILE=min(it.TILE, {width}))),
    (kernels.pack, dict(BLOCK=it.LEAST)),
):
    options = {{k: v for k, v in sizes.items() if k.startswith("num_")}}
    fixed = {{k: v for k, v in sizes.items() if k not in options}} | dict(WIDTH={width})
    shared = shared_bytes(kernel, fixed, options, kinds)
    assert shared <= 99 * 1024, (kernel.fn.__name__, shared)
""")
