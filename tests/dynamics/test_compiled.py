"""Compiled models: splines whose exact gradient is the force, fused loops against their twin."""

import copy
import importlib.util
import subprocess
import sys

import pytest
import torch

from dynamics import HEADS, Parameters, PhaseState, build, rollout, terms
from dynamics.compiled import compile_head
from dynamics.compiled.build import Sample
from dynamics.hamiltonian import Hamiltonian
from tests.shared.kernels import interpreted

DT = 0.002
needs_numba = pytest.mark.skipif(
    importlib.util.find_spec("numba") is None, reason="numba is not installed"
)
KINDS = ("displacement", "radial")


def model(kind: str, width: int = 16, scale: float = 8.0, law=(), **whole) -> Hamiltonian:
    """A random pair law with forces of order one, float64."""
    torch.manual_seed(3)
    pair = terms.TERMS[kind](width=width, **dict(law))
    head = build(terms.Hamiltonian(potentials=(pair,), **whole), 3, DT).double()
    with torch.no_grad():
        head.potential.phi.layers[-1].weight *= scale
    return head


def episodes(count: int, bodies: int = 3, dtype=torch.float64) -> tuple[PhaseState, Parameters]:
    rng = torch.Generator().manual_seed(5)

    def normal(*shape):
        return torch.randn(*shape, generator=rng, dtype=torch.float64).to(dtype)

    state = PhaseState(normal(count, bodies, 2), 0.5 * normal(count, bodies, 2))
    return state, Parameters(1 + 0.2 * normal(count).tanh(), 1 + 0.3 * normal(count, bodies).tanh())


def spread(count: int) -> torch.Tensor:
    """Displacements from deep in the core to far away."""
    rng = torch.Generator().manual_seed(1)
    way = torch.randn(count, 2, generator=rng, dtype=torch.float64)
    return way * torch.logspace(-3, 1.5, count, dtype=torch.float64).unsqueeze(-1)


@pytest.mark.parametrize("kind", KINDS)
def test_the_force_is_the_exact_gradient_of_the_spline(kind):
    spline = compile_head(model(kind), 1e-3).potential
    apart = spread(300).requires_grad_()
    (gradient,) = torch.autograd.grad(spline.pair_energy(apart).sum(), apart)
    torch.testing.assert_close(spline.pair_gradient(apart), gradient, rtol=1e-13, atol=3e-15)


@pytest.mark.parametrize("kind", KINDS)
def test_energy_and_force_are_continuous_across_cells(kind):
    spline = compile_head(model(kind), 1e-3).potential
    line = torch.linspace(0.2, 0.8, 20001, dtype=torch.float64)
    apart = torch.stack([line, 0.3 * line - 0.15], -1)  # crosses cells, and the half-plane's edge
    for value in (spline.pair_energy(apart).unsqueeze(-1), spline.pair_gradient(apart)):
        change = value.detach().diff(dim=0).norm(dim=-1)
        jump = 1e-4 * float(value.detach().norm(dim=-1).max())
        assert float(change.max()) < 3 * float(change.median()) + jump


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_the_tolerance_is_met_and_reported(kind, tolerance):
    head = model(kind)
    compiled = compile_head(head, tolerance, reach=20.0)
    apart = spread(500)
    apart = apart[apart.norm(dim=-1) < 19]
    found, exact = (x.potential.pair_gradient(apart).detach() for x in (compiled, head))
    # By the median: where one direction's force passes zero, its own size is no measure.
    assert float(((found - exact).norm(dim=-1) / exact.norm(dim=-1)).median()) <= tolerance
    assert compiled.report.error <= tolerance
    assert Sample.of(head.potential, 20.0).error(compiled.potential) == compiled.report.error


@pytest.mark.parametrize("kind", KINDS)
def test_the_reported_error_holds_in_the_model_s_own_precision(kind):
    fine, coarse = (compile_head(model(kind).to(d), 1e-6) for d in (torch.float64, torch.float32))
    rounding = torch.finfo(torch.float32).eps
    # What is evaluated in single precision is never closer than its rounding, and says so.
    assert fine.report.error <= 1e-6 and rounding / 4 < coarse.report.error <= 1e-6
    with pytest.raises(ValueError, match="in float32, not 1.0e-08"):
        compile_head(model(kind).float(), 1e-8)


def test_a_tolerance_that_no_spline_meets_is_refused():
    with pytest.raises(ValueError, match="the finest spline .* has a force error"):
        compile_head(model("radial"), 1e-16)


@pytest.mark.parametrize("kind", KINDS)
def test_beyond_the_reach_the_network_is_asked_and_counted(kind):
    head = model(kind)
    potential = compile_head(head, 1e-3, reach=2.0).potential
    near, far = (
        torch.tensor([[0.5, 0.1]]).double(),
        torch.tensor([[0.0, -2.5], [9.0, 1.0]]).double(),
    )
    found, exact = potential.pair_gradient(torch.cat([near, far])), head.potential.pair_gradient
    assert torch.equal(found[1:], exact(far)) and not torch.equal(found[:1], exact(near))
    assert torch.equal(potential.pair_energy(far), head.potential.pair_energy(far))
    assert potential.outside == 4


@needs_numba
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("tolerance", "reach"), [(1e-5, 100.0), (1e-5, 1.0), (None, 100.0)])
def test_numba_is_its_torch_twin_to_rounding(kind, tolerance, reach, dtype):
    head = model(kind).to(dtype)
    start, params = episodes(70, dtype=dtype)  # more than one block, and not a multiple of it
    fused = compile_head(head, tolerance, reach, backend="numba")
    twin = compile_head(head, tolerance, reach, backend="torch")
    found, expected = (x.trajectory(start, params, 30, DT, 3) for x in (fused, twin))
    assert (found.backend, expected.backend) == ("numba", "torch")
    size = 64 * torch.finfo(dtype).eps
    torch.testing.assert_close(found.states.q, expected.states.q, rtol=size, atol=size)
    torch.testing.assert_close(found.states.p, expected.states.p, rtol=size, atol=size)
    assert found.states.q.shape == (70, 11, 3, 2)
    # The twin looks at the start once more; it is the same pairs otherwise.
    assert found.fallbacks == expected.fallbacks
    assert (found.fallbacks > 0) == (tolerance is not None and reach == 1.0)


@needs_numba
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("tolerance", "reach", "box"),
    [(1e-4, 100.0, None), (1e-4, 0.2, None), (None, 100.0, None), (None, 100.0, 1.5)],
)
def test_one_step_in_numba_has_the_pair_law_s_forces(kind, tolerance, reach, box):
    """A single pair and step, by hand: short enough for kernels that are not compiled."""
    head = compile_head(model(kind, width=4, box=box), tolerance, reach, backend="numba")
    start, params = episodes(3, bodies=2)
    found = head.trajectory(start, params, 1, DT).states
    mass, strength = params.mass.unsqueeze(-1), (params.coupling * params.mass.prod(-1))[:, None]

    def kick(p: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
        apart = q[:, 0] - q[:, 1]
        nearest = apart if box is None else apart - box * (apart / box).round()
        pull = strength * head.potential.pair_gradient(nearest)
        return p + DT / 2 * torch.stack([-pull, pull], 1)

    half = kick(start.p, start.q)
    q = start.q + DT * half / mass
    torch.testing.assert_close(found.q[:, 1], q, rtol=0, atol=3e-15)
    torch.testing.assert_close(found.p[:, 1], kick(half, q), rtol=0, atol=3e-15)


@needs_numba
@pytest.mark.parametrize("activation", ["softplus", "silu"])
def test_other_activations_in_numba(activation):
    head = model("displacement", law={"activation": activation})
    start, params = episodes(5)
    fused, twin = (compile_head(head, None, backend=b) for b in ("numba", "torch"))
    found, expected = (x.trajectory(start, params, 10, DT).states.p for x in (fused, twin))
    torch.testing.assert_close(found, expected, rtol=1e-14, atol=1e-14)


@needs_numba
def test_numba_in_a_box_with_the_fourth_order_and_another_coupling():
    head = model("radial", law={"coupling": "quadratic"}, box=3.0, integrator="yoshida4")
    start, params = episodes(4, bodies=5)
    fused, twin = (compile_head(head, 1e-5, backend=b) for b in ("numba", "torch"))
    found, expected = (x.trajectory(start, params, 20, DT).states.q for x in (fused, twin))
    torch.testing.assert_close(found, expected, rtol=3e-15, atol=3e-15)


@needs_numba
def test_a_changed_law_is_followed_and_the_force_is_odd_in_it():
    head = model("displacement")
    start, params = episodes(6)
    compiled = compile_head(head, 1e-7)
    inverted = params.with_coupling(-params.coupling)
    found = rollout(compiled, start, inverted, 40, DT)
    assert found.backend == "numba"
    expected = rollout(head, start, inverted, 40, DT)
    torch.testing.assert_close(found.states.q, expected.states.q, rtol=1e-12, atol=1e-12)
    assert torch.equal(compiled.force(start, inverted), -compiled.force(start, params))


@needs_numba
@pytest.mark.parametrize("kind", KINDS)
def test_energy_stays_bounded_over_ten_thousand_steps(kind):
    head = model(kind, scale=20.0)
    start, params = episodes(8)
    compiled = compile_head(head, 1e-4)
    drifts = {}
    for name, model_ in (("spline", compiled), ("network", compile_head(head, None))):
        path = model_.trajectory(start, params, 10_000, DT, 100).states
        law = Parameters(params.coupling[:, None], params.mass[:, None])
        energy = (compiled if name == "spline" else head).energy(path, law)
        wrong = (energy - energy[:, :1]).abs()
        drifts[name] = float(wrong.max())
        # Bounded: the last half is not worse than the first by more than a little.
        assert float(wrong[:, 51:].max()) < 3 * float(wrong[:, :51].max())
    assert drifts["spline"] < 1.5 * drifts["network"]


def test_what_cannot_be_compiled_is_said():
    with pytest.raises(ValueError, match="no function of one displacement"):
        compile_head(build(HEADS["unstructured"], 3, DT))
    with pytest.raises(ValueError, match="SumPotential is no function of one displacement"):
        compile_head(
            build(terms.Hamiltonian(potentials=(terms.Displacement(), terms.Trap(1.0))), 3, DT)
        )
    with pytest.raises(ValueError, match="rolls .* with no ports"):
        compile_head(model("radial", ports=(terms.LinearFriction(),)), 1e-2, backend="numba")


def test_the_best_backend_falls_back_to_torch_and_says_so():
    head = compile_head(build(HEADS["factored-learned-kinetic"], 3, DT), 1e-2)
    start, params = episodes(2, dtype=torch.float32)
    assert rollout(head, start, params, 2, DT).backend == "torch"


@needs_numba
def test_a_compiled_model_does_not_change_with_the_one_it_came_from():
    head = model("radial")
    compiled = compile_head(head, 1e-3, reach=1.0)
    start, params = episodes(3)
    before = compiled.trajectory(start, params, 5, DT).states.q
    with torch.no_grad():
        for parameter in head.parameters():
            parameter.zero_()
    assert torch.equal(compiled.trajectory(start, params, 5, DT).states.q, before)
    assert torch.equal(copy.deepcopy(compiled).trajectory(start, params, 5, DT).states.q, before)


def test_importing_dynamics_imports_no_compiler():
    code = (
        "import sys, dynamics, dynamics.compiled; dynamics.build, dynamics.compiled.compile_head\n"
        "assert not {'numba', 'triton'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason="triton is not installed")
def test_the_triton_kernel_in_its_interpreter_is_the_torch_twin():
    code = """
import torch
from tests.dynamics import test_compiled as t
for kind, dtype in (("displacement", torch.float32), ("radial", torch.float64)):
    head, (start, params) = t.model(kind).to(dtype), t.episodes(5, dtype=dtype)
    for reach, ran in ((100.0, "triton"), (1.0, "torch")):
        paths = [
            t.compile_head(head, 1e-3, reach, backend=b).trajectory(start, params, 2, t.DT)
            for b in ("triton", "torch")
        ]
        assert paths[0].backend == ran and paths[0].fallbacks == paths[1].fallbacks
        size = 64 * torch.finfo(dtype).eps
        torch.testing.assert_close(paths[0].states.flat, paths[1].states.flat, rtol=size, atol=size)
"""
    interpreted(code)


@pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason="triton is not installed")
@pytest.mark.parametrize(
    ("bodies", "count", "width"),
    [
        (3, 5, 48),
        pytest.param(2, 9, 16, marks=pytest.mark.slow),
        pytest.param(5, 1, 64, marks=pytest.mark.slow),
    ],
)
def test_the_triton_kernel_of_a_network_is_the_torch_twin(bodies, count, width):
    """Widths that are no power of two, more rows than a program has, and fewer."""
    code = f"""
import torch
from tests.dynamics import test_compiled as t
head = t.model("displacement", {width}).float()
start, params = t.episodes({count}, {bodies}, torch.float32)
fast = t.compile_head(head, None, backend="triton")
with torch.no_grad():
    found = fast.trajectory(start, params, 4, t.DT, 2)
    there = head.double().plain_trajectory(start.map(torch.Tensor.double),
                                           params.map(torch.Tensor.double), 4, t.DT, 2)
assert found.backend == "triton"
moved = there.states.flat - there.states.flat[:, :1]
wrong = found.states.flat - there.states.flat
assert wrong.abs().max() < 2e-6 < 1e-3 < moved.abs().max(), (wrong.abs().max(), moved.abs().max())
"""
    interpreted(code)


@needs_numba
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_states_that_pass_the_caches_by_are_those_that_do_not(dtype):
    """An episode more than whole blocks: its rows begin anywhere, and are stored one by one."""
    from dynamics.compiled.steps import CACHED

    head = compile_head(model("radial").to(dtype), 1e-3, backend="numba")
    start, params = episodes(129, dtype=dtype)
    steps = CACHED // (128 * 12 * dtype.itemsize) + 1
    streamed = head.trajectory(start[:128], params[:128], steps, DT).states
    stored = head.trajectory(start, params, steps, DT).states
    assert torch.equal(streamed.flat, stored.flat[:128])
