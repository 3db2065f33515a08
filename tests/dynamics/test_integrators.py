"""Each integrator against problems that know their exact solution."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from dynamics import (
    INTEGRATORS,
    Hamiltonian,
    Integrator,
    PhaseState,
    VectorField,
    implicit_midpoint,
    leapfrog,
    rk4,
    rollout,
    tao,
    tao_gate,
    yoshida4,
)
from dynamics.integrators import Memory
from tests.shared.problems import (
    CHAIN,
    KEPLER,
    NON_SEPARABLE,
    PENDULUM,
    PROBLEMS,
    Problem,
    state,
    three_bodies,
)

ALL = tuple(INTEGRATORS.values())
SYMPLECTIC = tuple(m for m in ALL if m.symplectic)
# What these two hand over is a force, not a part of the state; tao hands over half its state.
FORCE_REUSING = (leapfrog, yoshida4)
CASES = [
    pytest.param(m, problem, id=f"{m.name}-{problem.name}")
    for m in ALL
    for problem in PROBLEMS
    if problem.field.separable or not m.needs_separable
]


def march(
    method: Integrator,
    field: VectorField,
    start: PhaseState,
    dt: float,
    steps: int,
    memory: Memory = None,
) -> tuple[PhaseState, Memory]:
    """``steps`` steps of ``dt`` seconds."""
    now = start
    for _ in range(steps):
        now, memory = method.advance(field, now, dt, memory)
    return now, memory


def slope_of(errors: list[float], dts: list[float]) -> float:
    """Slope of log error over log dt."""
    return float(np.polyfit(np.log(dts), np.log(errors), 1)[0])


def largest(x: Tensor) -> float:
    return float(x.abs().max())


# --- the problems themselves -------------------------------------------------------------------


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: p.name)
def test_the_exact_solution_solves_the_problem(problem: Problem) -> None:
    h, t = 1e-5, 0.7
    here = problem.exact(t)
    rate = (problem.exact(t + h).flat - problem.exact(t - h).flat) / (2 * h)
    slope = PhaseState(problem.field.velocity(here.q, here.p), problem.field.force(here.q, here.p))
    assert largest(rate - slope.flat) < 1e-9
    assert largest(problem.energy(here) - problem.energy(problem.start)) < 1e-13
    if problem is not CHAIN:  # three frequencies: no common period
        assert largest(problem.exact(problem.period).flat - problem.start.flat) < 1e-14


# --- order -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "problem"), CASES)
def test_measured_order_is_the_declared_order(method: Integrator, problem: Problem) -> None:
    end, errors = 2.0, []
    # the eighth order reaches rounding within a hundred steps
    counts = {"tao": [200, 400, 800], "kahan_li8": [12, 18, 24]}.get(method.name, [100, 200, 400])
    for n in counts:
        there, _ = march(method, problem.field, problem.start, end / n, n)
        errors.append(largest(there.flat - problem.exact(end).flat))
    slope = slope_of(errors, [end / n for n in counts])
    assert slope == pytest.approx(method.order, abs=0.05 if method.order == 2 else 0.1)
    assert errors[-1] < 1e-3  # a right slope towards a wrong answer would not do


def test_declared_orders() -> None:
    assert {m.name: m.order for m in ALL} == {
        "leapfrog": 2,
        "leapfrog_compensated": 2,
        "yoshida4": 4,
        "kahan_li8": 8,
        "rk4": 4,
        "implicit_midpoint": 2,
        "tao": 2,
    }


@pytest.mark.parametrize(("method", "tolerance"), [(leapfrog, 0.05), (yoshida4, 0.15)])
def test_order_on_three_bodies(method: Integrator, tolerance: float) -> None:
    head, start, params = three_bodies()
    field, end, dts = head.field(params), 0.5, [0.01, 0.005, 0.0025]
    truth, _ = march(yoshida4, field, start, end / 800, 800)
    errors = [
        largest(march(method, field, start, dt, round(end / dt))[0].flat - truth.flat) for dt in dts
    ]
    assert slope_of(errors, dts) == pytest.approx(method.order, abs=tolerance)


# --- time reversal -----------------------------------------------------------------------------


@pytest.mark.parametrize("method", SYMPLECTIC, ids=lambda m: m.name)
@pytest.mark.parametrize("problem", [PENDULUM, KEPLER], ids=lambda p: p.name)
def test_reversed_momentum_returns_to_the_start(method: Integrator, problem: Problem) -> None:
    dt = 0.02
    there, memory = march(method, problem.field, problem.start, dt, 200)
    if method is tao:  # its second copy is a state too
        memory = memory.reversed
    back, _ = march(method, problem.field, there.reversed, dt, 200, memory)
    assert largest(there.flat - problem.start.flat) > 0.1
    assert largest(back.reversed.flat - problem.start.flat) < 1e-13


@pytest.mark.parametrize("method", SYMPLECTIC, ids=lambda m: m.name)
def test_a_negative_step_undoes_a_step(method: Integrator) -> None:
    problem = PENDULUM if method.needs_separable else NON_SEPARABLE
    there, memory = march(method, problem.field, problem.exact(0.4), 0.05, 20)
    back, _ = march(method, problem.field, there, -0.05, 20, memory)
    assert largest(back.flat - problem.exact(0.4).flat) < 1e-14


def test_rk4_does_not_retrace() -> None:
    """The negative control of the two tests above."""
    there, _ = march(rk4, KEPLER.field, KEPLER.start, 0.02, 200)
    back, _ = march(rk4, KEPLER.field, there.reversed, 0.02, 200)
    assert largest(back.reversed.flat - KEPLER.start.flat) > 1e-9


@pytest.mark.parametrize(("dtype", "bar"), [(torch.float64, 1e-11), (torch.float32, 1e-3)])
def test_leapfrog_retraces_three_bodies(dtype: torch.dtype, bar: float) -> None:
    head, start, params = three_bodies(dtype)
    there = rollout(head, start, params, 2000, 0.002, every=2000).at(-1)
    back = rollout(head, there.reversed, params, 2000, 0.002, every=2000).at(-1)
    assert back.q.dtype == dtype
    assert largest(there.flat - start.flat) > 0.1
    assert largest(back.reversed.flat - start.flat) <= bar


# --- symplecticity -----------------------------------------------------------------------------


def symplectic_defect(step: Callable[[Tensor], Tensor], x: Tensor) -> float:
    """Largest entry of J^T Omega J - Omega at ``x``, whose first half is q and second half p."""
    jacobian = torch.autograd.functional.jacobian(step, x, vectorize=True)
    half = x.numel() // 2
    eye, zero = torch.eye(half, dtype=x.dtype), torch.zeros(half, half, dtype=x.dtype)
    omega = torch.cat([torch.cat([zero, eye], 1), torch.cat([-eye, zero], 1)])
    return largest(jacobian.T @ omega @ jacobian - omega)


def one_step(method: Integrator, field: VectorField, bodies: int, space: int, dt: float):
    def step(x: Tensor) -> Tensor:
        return method(field, PhaseState.from_flat(x, bodies, space), dt).flat

    return step


@pytest.mark.parametrize("method", [leapfrog, yoshida4, implicit_midpoint], ids=lambda m: m.name)
def test_the_flow_of_three_bodies_is_symplectic(method: Integrator) -> None:
    head, start, params = three_bodies()
    step = one_step(method, head.field(params), 3, 2, dt=0.02)
    assert symplectic_defect(step, start.flat) < 1e-14


def test_the_flow_of_implicit_midpoint_is_symplectic_where_energies_do_not_separate() -> None:
    step = one_step(implicit_midpoint, NON_SEPARABLE.field, 1, 1, dt=0.1)
    assert symplectic_defect(step, NON_SEPARABLE.exact(0.6).flat) < 3e-15


def test_rk4_is_not_symplectic() -> None:
    """The negative control: the check above can fail."""
    step = one_step(rk4, KEPLER.field, 1, 2, dt=0.1)
    assert symplectic_defect(step, KEPLER.start.flat) > 1e-7
    assert not rk4.symplectic


@pytest.mark.parametrize("problem", [PENDULUM, NON_SEPARABLE], ids=lambda p: p.name)
def test_tao_is_symplectic_in_the_doubled_phase_space(problem: Problem) -> None:
    def step(z: Tensor) -> Tensor:  # z = (q, x, p, y); the pairs are (q, p) and (x, y)
        q, x, p, y = z.reshape(4, 1, 1)
        now, shadow = tao.advance(problem.field, PhaseState(q, p), 0.1, PhaseState(x, y))
        return torch.cat([now.q, shadow.q, now.p, shadow.p]).flatten()

    apart = torch.tensor([0.7, 0.65, -0.4, -0.35], dtype=torch.float64)
    assert symplectic_defect(step, apart) < 1e-14


# --- energy over long times --------------------------------------------------------------------

WINDOW = 10  # periods


def energy_errors(method: Integrator, problem: Problem, periods: int, steps: int) -> Tensor:
    """H(t) - H(0) after each of ``steps`` steps a period, one row for each ten periods."""
    now, memory, energies = problem.start, None, []
    for _ in range(periods * steps):
        now, memory = method.advance(problem.field, now, problem.period / steps, memory)
        energies.append(problem.energy(now))
    return (torch.stack(energies) - problem.energy(problem.start)).reshape(-1, WINDOW * steps)


def trend(errors: Tensor) -> float:
    """What the mean error gains over the whole run, relative to the largest error."""
    means = errors.mean(1).numpy()
    slope = np.polyfit(np.arange(len(means)), means, 1)[0]
    return float(slope * len(means)) / largest(errors)


@pytest.mark.parametrize(
    ("method", "problem", "steps", "amplitude"),
    [
        pytest.param(leapfrog, PENDULUM, 12, 0.08, id="leapfrog"),
        pytest.param(yoshida4, PENDULUM, 12, 0.02, id="yoshida4"),
        pytest.param(
            implicit_midpoint, PENDULUM, 12, 0.02, id="implicit_midpoint", marks=pytest.mark.slow
        ),
        pytest.param(tao, NON_SEPARABLE, 20, 0.06, id="tao"),
    ],
)
def test_energy_stays_flat_for_a_thousand_periods(
    method: Integrator, problem: Problem, steps: int, amplitude: float
) -> None:
    errors = energy_errors(method, problem, 1000, steps)
    assert largest(errors) < amplitude
    assert largest(errors[-10:]) < 1.02 * largest(errors[:10])
    assert abs(trend(errors)) < 0.002


def test_the_energy_of_rk4_drifts() -> None:
    """The negative control of the test above."""
    errors = energy_errors(rk4, PENDULUM, 200, 12)
    assert largest(errors[-1]) > 5 * largest(errors[0])
    assert abs(trend(errors)) > 0.5


def test_leapfrog_energy_oscillates_with_the_square_of_the_step() -> None:
    """P1: leapfrog conserves a modified Hamiltonian that is O(dt^2) away from H."""
    dts, amplitudes = [0.1, 0.05, 0.025], []
    for dt in dts:
        now, force, energies = PENDULUM.start, None, []
        for _ in range(round(2 * PENDULUM.period / dt)):
            now, force = leapfrog.advance(PENDULUM.field, now, dt, force)
            energies.append(PENDULUM.energy(now))
        every = torch.stack(energies)
        amplitudes.append(float(every.max() - every.min()))
    assert slope_of(amplitudes, dts) == pytest.approx(2, abs=0.01)


def test_leapfrog_conserves_the_modified_hamiltonian_of_a_spring() -> None:
    """Kick-drift-kick on H = (p^2 + q^2) / 2 conserves p^2 + (1 - dt^2 / 4) q^2 exactly."""
    dt = 0.5
    field = VectorField(lambda q, p: p, lambda q, p: -q)
    now, force = state([1.0], [0.3], space=1), None

    def modified(s: PhaseState) -> float:
        return float(s.p.square() + (1 - dt**2 / 4) * s.q.square())

    before = modified(now)
    for _ in range(200):
        now, force = leapfrog.advance(field, now, dt, force)
        assert modified(now) == pytest.approx(before, abs=1e-13)


# --- cost and re-use ---------------------------------------------------------------------------


def counted(field: VectorField) -> tuple[VectorField, list[int]]:
    """The field, and a list that grows by one entry with each force evaluation."""
    calls: list[int] = []

    def force(q: Tensor, p: Tensor) -> Tensor:
        calls.append(1)
        return field.force(q, p)

    return replace(field, force=force), calls


@pytest.mark.parametrize(
    ("method", "a_step"),
    [(leapfrog, 1), (yoshida4, 3), (rk4, 4), (tao, 4)],
    ids=lambda x: getattr(x, "name", str(x)),
)
def test_force_evaluations_a_step(method: Integrator, a_step: int) -> None:
    field, calls = counted(PENDULUM.field)
    now, memory = march(method, field, PENDULUM.start, 0.05, 1)
    assert len(calls) - (method in FORCE_REUSING) == a_step == method.forces_per_step
    calls.clear()
    march(method, field, now, 0.05, 10, memory)
    assert len(calls) == 10 * a_step


def test_implicit_midpoint_costs_about_what_it_declares() -> None:
    head, start, params = three_bodies()
    field, calls = counted(head.field(params))
    march(implicit_midpoint, field, start, 0.01, 50)
    assert len(calls) / 50 == pytest.approx(implicit_midpoint.forces_per_step, abs=3)


def test_a_rollout_evaluates_the_force_once_a_step_and_once_to_open() -> None:
    head, start, params = three_bodies()
    calls: list[int] = []
    force = head.potential.force
    head.potential.force = lambda q, c: calls.append(1) or force(q, c)
    rollout(head, start, params, 50, 0.002)
    assert len(calls) == 51


@pytest.mark.parametrize("method", FORCE_REUSING, ids=lambda m: m.name)
def test_reuse_changes_no_bit(method: Integrator) -> None:
    head, start, params = three_bodies()
    field = head.field(params)
    reused, _ = march(method, field, start, 0.002, 50)
    fresh = start
    for _ in range(50):
        fresh = method(field, fresh, 0.002)
    assert torch.equal(reused.flat, fresh.flat)


# --- implicit midpoint -------------------------------------------------------------------------


def test_implicit_midpoint_conserves_quadratic_invariants() -> None:
    dt, steps = 0.05, 1000
    there, _ = march(implicit_midpoint, CHAIN.field, CHAIN.start, dt, steps)
    assert largest(CHAIN.energy(there) / CHAIN.energy(CHAIN.start) - 1) < 1e-13
    control, _ = march(leapfrog, CHAIN.field, CHAIN.start, dt, steps)
    assert largest(CHAIN.energy(control) / CHAIN.energy(CHAIN.start) - 1) > 1e-6

    def spin(s: PhaseState) -> Tensor:
        return s.q[0, 0] * s.p[0, 1] - s.q[0, 1] * s.p[0, 0]

    there, _ = march(implicit_midpoint, KEPLER.field, KEPLER.start, dt, 200)
    assert largest(spin(there) - spin(KEPLER.start)) < 1e-14


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_implicit_midpoint_solves_its_equation_to_rounding(dtype: torch.dtype) -> None:
    start = NON_SEPARABLE.exact(0.6).map(lambda x: x.to(dtype))
    field, dt = NON_SEPARABLE.field, 0.1
    after = implicit_midpoint(field, start, dt)
    mid_q, mid_p = (start.q + after.q) / 2, (start.p + after.p) / 2
    bar = 20 * torch.finfo(dtype).eps
    assert largest(after.q - start.q - dt * field.velocity(mid_q, mid_p)) < bar
    assert largest(after.p - start.p - dt * field.force(mid_q, mid_p)) < bar


def test_implicit_midpoint_says_when_it_does_not_converge() -> None:
    with pytest.raises(RuntimeError, match=r"implicit_midpoint.*not converge.*smaller dt than 5 s"):
        implicit_midpoint(CHAIN.field, CHAIN.start, 5.0)


@pytest.mark.parametrize("part", ["velocity", "force"])
def test_implicit_midpoint_refuses_nan(part: str) -> None:
    def nan(q: Tensor, p: Tensor) -> Tensor:
        return torch.full_like(q, math.nan)

    still = state([0.0], [0.0], space=1)
    field = VectorField(lambda q, p: torch.zeros_like(q), lambda q, p: torch.zeros_like(q))
    with pytest.raises(RuntimeError, match="nan"):
        implicit_midpoint(replace(field, **{part: nan}), still, 0.1)


def test_implicit_midpoint_converges_for_each_episode_not_for_the_batch() -> None:
    """One small and stiff episode among many that are large, soft and solved at once."""
    field = VectorField(lambda q, p: p, lambda q, p: -100 * q / (1 + q.square()))
    small, large = state([1e-3], [2e-3], space=1), state([1e6], [2e6], space=1)
    together = implicit_midpoint(field, PhaseState.stack([small] + 1000 * [large], 0), 0.1)
    alone = implicit_midpoint(field, small, 0.1)
    assert largest(together[0].flat / alone.flat - 1) < 3e-15


def test_implicit_midpoint_stops_where_rounding_keeps_it_from_settling() -> None:
    """Positions known to 1e-13 only, as far from the origin: some steps end in a two-cycle."""
    field = VectorField(lambda q, p: p, lambda q, p: -((q + 1000) - 1000))
    start = state([1.0], [0.3], space=1)
    end, _ = march(implicit_midpoint, field, start, 0.5, 300)
    assert largest(end.flat.square().sum() - start.flat.square().sum()) < 1e-12


def test_implicit_midpoint_keeps_a_still_body_still() -> None:
    field = VectorField(lambda q, p: p, lambda q, p: torch.zeros_like(q))
    still = state([0.0], [0.0], space=1)
    assert torch.equal(implicit_midpoint(field, still, 0.1).flat, still.flat)


def test_implicit_midpoint_of_no_episodes_is_none() -> None:
    nobody = PhaseState(torch.zeros(0, 3, 2), torch.zeros(0, 3, 2))
    assert implicit_midpoint(PENDULUM.field, nobody, 0.1).q.shape == (0, 3, 2)


# --- Tao's scheme ------------------------------------------------------------------------------


def test_the_tao_gate_passes_at_the_study_s_step() -> None:
    assert 1e-6 < tao_gate(0.01) < 5e-5


@pytest.mark.parametrize("dt", [0.05, 2.0, math.nan])
def test_the_tao_gate_refuses_a_large_step(dt: float) -> None:
    words = rf"tao.*gate failed at dt = {dt:g} s.* > 0.0001 in 2000 steps; use a smaller dt"
    with pytest.raises(ValueError, match=words):
        tao_gate(dt)


def test_tao_without_memory_starts_its_copy_at_the_state() -> None:
    start = NON_SEPARABLE.start
    fresh = tao.advance(NON_SEPARABLE.field, start, 0.01, None)
    given = tao.advance(NON_SEPARABLE.field, start, 0.01, start)
    assert torch.equal(fresh[0].flat, given[0].flat)
    assert torch.equal(fresh[1].flat, given[1].flat)


def test_tao_binds_its_two_copies() -> None:
    """Without the rotation of strength omega the copies part; with it they stay together."""
    now, shadow = march(tao, NON_SEPARABLE.field, NON_SEPARABLE.start, 0.01, 2000)
    assert largest(now.flat - shadow.flat) < 1e-3


def test_tao_turns_the_difference_of_its_copies() -> None:
    """Without a field a step is exp(dt H_C), H_C = omega (|q - x|^2 + |p - y|^2) / 2, omega 20."""
    zero = VectorField(lambda q, p: torch.zeros_like(q), lambda q, p: torch.zeros_like(q))
    now, shadow = state([0.7], [-0.4], space=1), state([0.6], [-0.1], space=1)
    after, copy = tao.advance(zero, now, 0.013, shadow)
    apart = torch.complex(now.q - shadow.q, now.p - shadow.p)
    turned = torch.complex(after.q - copy.q, after.p - copy.p)
    turn = cmath.exp(-1j * 2 * 100 * 0.013)  # dq/dt = dH_C/dp: clockwise
    assert largest(turned - turn * apart) < 1e-15
    assert largest(after.flat + copy.flat - now.flat - shadow.flat) < 1e-15


# --- the interface -----------------------------------------------------------------------------


@pytest.mark.parametrize("method", [leapfrog, yoshida4], ids=lambda m: m.name)
def test_a_method_for_separable_fields_refuses_another(method: Integrator) -> None:
    with pytest.raises(ValueError, match=rf"{method.name} needs a separable .*tao"):
        method(NON_SEPARABLE.field, NON_SEPARABLE.start, 0.01)


@pytest.mark.parametrize("method", ALL, ids=lambda m: m.name)
def test_a_call_is_one_advance_and_steps_of_zero_do_nothing(method: Integrator) -> None:
    start = PENDULUM.exact(0.4)
    called = method(PENDULUM.field, start, 0.05)
    assert torch.equal(called.flat, method.advance(PENDULUM.field, start, 0.05, None)[0].flat)
    assert largest(method(PENDULUM.field, start, 0.0).flat - start.flat) < 1e-15


@pytest.mark.parametrize("method", ALL, ids=lambda m: m.name)
def test_a_batch_steps_as_its_slices(method: Integrator) -> None:
    head, start, params = three_bodies()
    batch = start.map(lambda x: torch.stack([x, 1.1 * x, 0.9 * x]))
    many = params.map(lambda x: x.expand(3, *x.shape))
    together = Hamiltonian(head.kinetic, head.potential, method).advance(batch, many, 0.002)[0]
    for k in range(3):
        alone = method(head.field(params), batch[k], 0.002)
        assert largest(together[k].flat - alone.flat) < 3e-15


@pytest.mark.parametrize("method", [leapfrog, yoshida4, rk4, tao], ids=lambda m: m.name)
def test_vmap_and_jvp_pass_through_advance(method: Integrator) -> None:
    head, start, params = three_bodies()
    model = Hamiltonian(head.kinetic, head.potential, method)

    def step(q: Tensor, p: Tensor) -> Tensor:
        return model.advance(PhaseState(q, p), params, 0.01)[0].flat

    q, p = (torch.stack([x, 1.1 * x]) for x in (start.q, start.p))
    mapped = torch.func.vmap(step)(q, p)
    assert largest(mapped[1] - step(q[1], p[1])) < 3e-15

    direction = torch.randn_like(start.q)
    _, tangent = torch.func.jvp(lambda x: step(x, start.p), (start.q,), (direction,))
    h = 1e-6
    ahead, behind = (step(start.q + s * h * direction, start.p) for s in (1, -1))
    assert largest(tangent - (ahead - behind) / (2 * h)) < 1e-8
