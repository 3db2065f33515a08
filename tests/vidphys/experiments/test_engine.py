"""S7, S11 and the models in generalised coordinates, against closed forms."""

from dataclasses import replace
from types import ModuleType

import pytest
import torch
from torch import Generator, Tensor

from dynamics import Head, PhaseState, build, leapfrog, rk4, rollout, terms
from dynamics.angles import AnglePotential, Harmonics, frequencies
from dynamics.generalised import GeneralisedHamiltonian, Lagrangian
from dynamics.metric import CholeskyMetric
from vidphys.errors import InputError
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_changed_law
from vidphys.experiments.friction import engine as tables_engine
from vidphys.experiments.friction.derivatives import REACH, derivative_segments, match_slopes
from vidphys.experiments.friction.engine import DAMPED, ENGINE, FREE, engine_cell
from vidphys.presets import OracleSizes
from vidphys.runs.records import Recorder
from vidphys.scenes import certify, engine
from vidphys.scenes.pendulum import pendulum
from vidphys.training.segments import scale_of

F64 = torch.float64
# A capsule of radius 0.05 and length 1 about its end, and the arms of two such links.
OWN = 0.34557031
TINY = OracleSizes(32, 4, 64, (5e-3,), 4)


def sample(episodes: int = 16, friction: str | None = None):
    scene = pendulum(friction)
    return scene, *scene.sample(episodes, Generator().manual_seed(3))


def mass_matrix(q: Tensor) -> Tensor:
    """M(q) of two 1 m links of 1 kg in relative angles, ``(b, 2, 1) -> (b, 2, 2)``."""
    cosine, one = q[:, 1, 0].cos(), torch.ones(len(q), dtype=F64)
    across = OWN * one + 0.5 * cosine
    rows = [2 * OWN + one + cosine, across, across, OWN * one]
    return torch.stack(rows, -1).unflatten(-1, (2, 2))


def height(q: Tensor) -> Tensor:
    first, second = q[:, 0, 0], q[:, 0, 0] + q[:, 1, 0]
    return -9.81 * (1.5 * first.cos() + 0.5 * second.cos())


def test_the_engine_has_the_mass_matrix_and_energy_of_a_double_pendulum():
    scene, start, params = sample()
    matrix = mass_matrix(start.q)
    v = torch.linalg.solve(matrix, start.p)
    torch.testing.assert_close(scene.engine.velocities(start), v.squeeze(-1), atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(scene.engine.momenta(start.q, v), start.p, atol=1e-7, rtol=1e-7)
    energy = 0.5 * (start.p * v).sum((1, 2)) + params.coupling * height(start.q)
    found = scene.law.energy(start, params)
    torch.testing.assert_close(found - found[0], energy - energy[0], atol=1e-5, rtol=0)


def test_force_is_the_time_derivative_of_momentum():
    scene, start, params = sample()
    path = scene.simulate(start, params, 8)
    middle = path.at(4)
    weights = torch.tensor([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    slope = (weights.to(F64)[:, None, None] * path.states.p).sum(1) / scene.dt
    torch.testing.assert_close(scene.law.force(middle, params), slope, atol=1e-4, rtol=1e-5)


@pytest.mark.parametrize("coupling", [1.0, -1.0])
def test_reference_keeps_energy_under_either_sign_and_is_certified(coupling):
    scene, start, params = sample()
    path = scene.simulate(start, params.with_coupling(coupling), 300, 10)
    proof = certify(scene, path)
    assert proof.passed.all()
    assert float(proof.drift.max()) < 1e-5


def test_a_hanging_pendulum_swings_with_its_small_angle_periods():
    scene, _, params = sample(1)
    start = PhaseState(torch.tensor([[[1e-4], [0.0]]]).to(F64), torch.zeros(1, 2, 1).to(F64))
    one = params.with_coupling(1.0)
    path = scene.simulate(start, one, 100)
    still = mass_matrix(torch.zeros(1, 2, 1).to(F64))[0]
    stiff = 9.81 * torch.tensor([[2.0, 0.5], [0.5, 0.5]]).to(F64)
    half = torch.linalg.cholesky(still)
    squares, modes = torch.linalg.eigh(torch.linalg.inv(half) @ stiff @ torch.linalg.inv(half).T)
    to_modes = modes.T @ half.T
    phase = squares.sqrt() * path.times[:, None]
    expected = torch.linalg.solve(to_modes, ((to_modes @ start.q[0]).T * phase.cos()).T).T
    torch.testing.assert_close(path.states.q[0, :, :, 0], expected, atol=1e-10, rtol=0)


def test_no_weight_leaves_the_momentum_conjugate_to_the_whole_turning():
    scene, start, params = sample()
    free = scene.straight_lines(start, params, 100, 5)
    turning = free.states.p[:, :, 0]
    torch.testing.assert_close(turning, turning[:, :1].expand_as(turning), atol=1e-7, rtol=0)


def test_an_unknown_friction_is_named():
    with pytest.raises(InputError, match="linear or square"):
        pendulum("cubic")


def test_importing_scenes_and_tables_leaves_the_engine_alone():
    # Asked of the sources, since another test of the process may have used the engine.
    for module in (engine, tables_engine):
        names = {x.__name__ for x in vars(module).values() if isinstance(x, ModuleType)}
        assert "mujoco" not in names


def test_harmonics_are_periodic_and_their_derivatives_adjoint():
    torch.manual_seed(0)
    harmonics = Harmonics(3).double()
    assert len(frequencies(3)) == 13
    q, direction = torch.randn(5, 3, dtype=F64), torch.randn(5, 3, dtype=F64)
    torch.testing.assert_close(harmonics(q), harmonics(q + 2 * torch.pi), atol=1e-13, rtol=0)
    pushed = harmonics.pushforward(q, direction)
    _, exact = torch.func.jvp(harmonics, (q,), (direction,))
    torch.testing.assert_close(pushed, exact, rtol=3e-15, atol=3e-15)
    weights = torch.randn_like(pushed)
    left, right = (harmonics.pullback(q, weights) * direction).sum(), (weights * pushed).sum()
    torch.testing.assert_close(left, right, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("form", ["mass", "inverse"])
@pytest.mark.parametrize("joints", [1, 2, 3])
def test_the_metric_is_positive_and_its_slopes_are_those_of_the_energy(form, joints):
    torch.manual_seed(joints)
    metric = CholeskyMetric(joints, 8, "tanh", form).double()
    q, p = torch.randn(6, joints, dtype=F64), torch.randn(6, joints, dtype=F64)
    inverse = metric.inverse(q)
    torch.testing.assert_close(inverse, inverse.mT, rtol=3e-15, atol=3e-15)
    assert torch.linalg.eigvalsh(inverse).min() > 0
    torch.testing.assert_close(metric.momentum(q, metric.velocity(q, p)), p, rtol=1e-14, atol=1e-14)

    def kinetic(q: Tensor) -> Tensor:
        return 0.5 * (p * metric.velocity(q, p)).sum()

    velocity, bent = metric.hamilton(q, p)
    torch.testing.assert_close(
        velocity, (inverse @ p.unsqueeze(-1)).squeeze(-1), rtol=1e-14, atol=1e-14
    )
    torch.testing.assert_close(bent, -torch.func.grad(kinetic)(q), rtol=1e-14, atol=1e-14)


def test_a_metric_of_another_form_is_refused():
    q = torch.zeros(1, 2)
    with pytest.raises(ValueError, match="need the form 'mass'"):
        CholeskyMetric(2, 8, "tanh", "inverse").coriolis(q, q)
    with pytest.raises(ValueError, match="mass or inverse"):
        CholeskyMetric(2, 8, "tanh", "covariant")


def models() -> tuple[Lagrangian, GeneralisedHamiltonian]:
    torch.manual_seed(0)
    potential = AnglePotential(2, 0, 8, "tanh")
    parts = CholeskyMetric(2, 8, "tanh", "mass"), potential, rk4, 0.01
    return Lagrangian(*parts).double(), GeneralisedHamiltonian(*parts).double()


@pytest.mark.parametrize("conditions", [0, 3])
def test_a_law_of_angles_is_its_network_times_a_typical_force(conditions: int):
    potential = AnglePotential(2, conditions, 8, "tanh").double()
    potential.set_scale(3.0)
    _, start, params = sample(2)
    given = params.flat if conditions else start.q.new_zeros(2, 0)
    inputs = torch.cat([potential.harmonics(start.q.flatten(-2)), given], -1)
    expected = 3 * potential.network(inputs).squeeze(-1)
    expected = expected if conditions else expected * params.coupling
    torch.testing.assert_close(potential.energy(start.q, params), expected, rtol=1e-14, atol=0)


def test_both_formalisms_move_alike():
    lagrangian, hamiltonian = models()
    _, start, params = sample(4)
    ends = [rollout(m, start, params, 40, 0.0025).at(-1) for m in (lagrangian, hamiltonian)]
    torch.testing.assert_close(ends[0].flat, ends[1].flat, atol=1e-9, rtol=0)


def test_a_factored_law_is_odd_in_gravity_at_rest_and_a_free_one_is_not():
    _, start, params = sample(4)
    rest = PhaseState(start.q, torch.zeros_like(start.p))
    for factored in (True, False):
        torch.manual_seed(0)
        term = terms.GeneralisedHamiltonian(factored=factored, width=8, integrator="rk4")
        head = build(term, 2, 0.01, 1).double()
        there, back = (head.force(rest, params.with_coupling(g)) for g in (1.0, -1.0))
        assert bool((there == -back).all()) is factored


def test_a_head_keeps_its_energy_and_refuses_what_its_field_cannot_take():
    head = build(terms.GeneralisedHamiltonian(width=8), 2, 0.01, 1).double()
    _, start, params = sample(4)
    path = rollout(head, start, params, 40, 0.01)
    energy = [head.energy(path.at(t), params).detach() for t in (0, -1)]
    torch.testing.assert_close(*energy, atol=0.02, rtol=0)
    assert float((path.at(-1).q - start.q).abs().max()) > 0.1
    with pytest.raises(ValueError, match="calibration gate failed"):
        build(terms.GeneralisedHamiltonian(width=8), 2, 0.1, 1)
    parts = CholeskyMetric(2, 8, "tanh", "mass"), AnglePotential(2, 0, 8, "tanh")
    with pytest.raises(ValueError, match="separable"):
        GeneralisedHamiltonian(*parts, leapfrog, 0.01)


def test_a_map_of_angles_does_not_see_whole_turns():
    head = build(terms.Residual(width=8, angles=True), 2, 0.01, 1).double()
    _, start, params = sample(4)
    turned = PhaseState(start.q + 2 * torch.pi, start.p)
    one, other = (head.advance(s, params, 0.01)[0] for s in (start, turned))
    torch.testing.assert_close(one.p, other.p, rtol=3e-15, atol=3e-15)


def test_stencils_give_the_derivatives_of_the_engine():
    scene, start, params = sample()
    path = scene.simulate(start, params, 10)
    segments = derivative_segments(path)
    inner = path.states[:, REACH:-REACH]
    law = params.map(lambda x: x.unsqueeze(1))
    force = scene.law.force(inner, law).flatten(0, 1)
    assert segments.p is not None and len(segments) == len(force)
    torch.testing.assert_close(segments.p[:, 0].double() / scene.dt, force, atol=2e-3, rtol=1e-4)
    torch.testing.assert_close(
        segments.start.q, inner.q.flatten(0, 1).float(), rtol=1e-6, atol=1e-6
    )


def test_matching_slopes_reaches_zero_only_at_the_law_itself():
    _, head = models()
    _, start, params = sample(4)
    path = rollout(head, start, params, 10, 0.01)
    batch = derivative_segments(path)
    scale = scale_of(batch)
    head.float()
    assert float(match_slopes(head, batch, scale).detach()) < 1e-12
    other, _ = models()
    other.float().potential.set_scale(1.1)
    assert float(match_slopes(other, batch, scale).detach()) > 1e-4


def glance(recorder: Recorder, head: Head, question: Question) -> None:
    """The questions of a cell, over a few steps."""
    short = replace(question, steps=5)
    score_changed_law(recorder, head, short, short.params.with_coupling(-1.0), short.params)
    score_retrace(recorder, head, short)


@pytest.mark.parametrize("name", ["free/unstructured", "free/hnn"])
def test_a_cell_trains_every_seed_and_leaves_records(name):
    task = CellTask("engine", name, (0, 1), TINY)
    engine_cell(FREE[name], pendulum, glance)(task)
    assert set(ENGINE.cells) == set(FREE) | set(DAMPED)
    assert [recorder.origin.seed for recorder in task.recorders] == [0, 1]
    for recorder in task.recorders:
        found = {row["metric"] for row in recorder.rows}
        assert {"inversion_nmse", "ballistic_skill", "force_cosine", "retrace_nmse"} <= found
        assert "held_out_one_step_error" in found
