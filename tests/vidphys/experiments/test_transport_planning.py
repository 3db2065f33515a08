"""The transport bound, planning through a model, and noisy starts."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Generator

from dynamics import PhaseState, ballistic, rollout
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.oracle import held_out_question
from vidphys.experiments.gravity import planning
from vidphys.experiments.gravity.planning import (
    KICKED,
    PLANNING,
    final_position,
    score_noise,
    score_plans,
)
from vidphys.experiments.gravity.transport import TRANSPORT
from vidphys.experiments.gravity.transport_score import flow, generator, linear_transport
from vidphys.presets import OracleSizes
from vidphys.scenes import gravity
from vidphys.shooting.impulse import kicked, plan_impulse

TINY = OracleSizes(32, 4, 64, (5e-3,), 4)


def numbers(task):
    return {
        (row["cell"], row["metric"], row["coupling"]): row["value"]
        for recorder in task.recorders
        for row in recorder.rows
    }


# --- transport (P3) ----------------------------------------------------------------------------


def test_the_flow_of_an_oscillator_is_its_cosine():
    field = generator(torch.tensor([[4.0]], dtype=torch.float64))
    times = torch.linspace(0, 3, 7, dtype=torch.float64)
    x = flow(field, torch.tensor([1.0, 0.0], dtype=torch.float64), times)
    assert torch.allclose(x[:, 0], (2 * times).cos(), atol=1e-12)
    assert torch.allclose(x[:, 1], -2 * (2 * times).sin(), atol=1e-12)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10_000), size=st.floats(1e-3, 1.0))
def test_the_bound_holds_for_any_linear_fields(seed, size):
    rng = Generator().manual_seed(seed)
    truth, off, further = (torch.randn(4, 4, generator=rng, dtype=torch.float64) for _ in range(3))
    content = truth + size * off
    deployed = content + size * further
    x = torch.randn(4, generator=rng, dtype=torch.float64)
    wrong = size * torch.randn(4, generator=rng, dtype=torch.float64)
    times = torch.linspace(0, 1.5, 16, dtype=torch.float64)
    reference, predicted = flow(truth, x, times), flow(deployed, x + wrong, times)
    radius = torch.maximum(reference.norm(dim=-1), predicted.norm(dim=-1)).max()
    terms = linear_transport(deployed, content, truth, wrong.norm(), radius)
    bound = torch.stack([terms.log_score(t) for t in times]).exp()
    distance = (predicted - reference).norm(dim=-1)
    assert bool((distance <= bound * (1 + 1e-9)).all())


def test_the_bound_s_terms_are_what_they_say():
    eye = torch.eye(2, dtype=torch.float64)
    terms = linear_transport(
        3.0 * eye,
        2.5 * eye,
        2.0 * eye,
        torch.tensor(0.1, dtype=torch.float64),
        torch.tensor(4.0, dtype=torch.float64),
    )
    assert (float(terms.content), float(terms.map_error), float(terms.lipschitz)) == (2, 2, 3)
    after = terms.log_score(torch.tensor(2.0, dtype=torch.float64))
    assert math.isclose(float(after), 6 + math.log(0.1 + 2 * 4))


def test_a_model_that_is_the_truth_has_the_initial_term_alone():
    field = generator(torch.tensor([[2.0, -1.0], [-1.0, 2.0]], dtype=torch.float64))
    off = torch.tensor(0.01, dtype=torch.float64)
    terms = linear_transport(field, field, field, off, torch.tensor(5.0, dtype=torch.float64))
    assert (float(terms.content), float(terms.map_error)) == (0, 0)


def test_the_transport_table_ranks_and_stays_within_the_bound():
    task = CellTask("transport", "oscillators", (0,), OracleSizes(128, 4, 64, (5e-3,), 4))
    TRANSPORT.cells["oscillators"](task)
    found = numbers(task)
    assert found["oscillators", "bound_held", None] == 1
    score = found["oscillators", "spearman_score", None]
    assert score > 0.8 > 0.3 > found["oscillators", "spearman_initial", None]


# --- planning ----------------------------------------------------------------------------------


def free_bodies(episodes=6):
    scene = gravity()
    start, params = scene.sample(episodes, Generator().manual_seed(0))
    return scene, start, params


def test_a_plan_through_straight_lines_is_the_exact_impulse():
    scene, start, params = free_bodies()
    target = start.q[:, KICKED] + torch.randn(6, 2, generator=Generator().manual_seed(1)).double()
    plan = plan_impulse(
        lambda s: final_position(ballistic(), params, scene.dt, s), start, target, budget=100.0
    )
    mass = params.mass[:, KICKED, None]
    seconds = planning.STEPS * scene.dt
    exact = mass * (target - start.q[:, KICKED]) / seconds - start.p[:, KICKED]
    assert torch.allclose(plan.impulse, exact, atol=1e-6)
    assert float(plan.error.max()) < 1e-6


def test_no_impulse_is_over_the_budget():
    scene, start, params = free_bodies()
    plan = plan_impulse(
        lambda s: final_position(ballistic(), params, scene.dt, s),
        start,
        start.q[:, KICKED] + 50.0,
        budget=0.7,
    )
    assert float(plan.impulse.norm(dim=-1).max()) <= 0.7 + 1e-12


def test_a_model_that_is_lost_keeps_the_best_plan_it_had():
    _, start, _ = free_bodies()
    target = start.q[:, KICKED] + 1.0

    def lost(state: PhaseState) -> torch.Tensor:
        moved = state.p[:, KICKED] != start.p[:, KICKED].repeat(len(state.p) // 6, 1)
        return state.q[:, KICKED].masked_fill(moved.any(-1, keepdim=True), torch.nan)

    plan = plan_impulse(lost, start, target, 1.0)
    assert float(plan.impulse.abs().max()) == 0
    assert torch.allclose(plan.error, torch.full((6,), 2.0).double().sqrt())


def test_an_impulse_pushes_one_body_only():
    _, start, _ = free_bodies()
    pushed = kicked(start, torch.ones(6, 2).double())
    assert torch.equal(pushed.q, start.q)
    assert torch.equal(pushed.p[:, KICKED], start.p[:, KICKED] + 1)
    assert torch.equal(pushed.p[:, 1:], start.p[:, 1:])


def test_the_exact_law_executes_its_own_plans(monkeypatch):
    monkeypatch.setattr(planning, "STEPS", 100)
    scene = gravity()
    task = CellTask("planning", "exact", (0,), TINY)
    question = held_out_question(scene, 6, 0)
    recorder = task.recorder(0, scene, "exact")
    score_plans(recorder, scene.law, question, 0)
    found = numbers(task)
    assert found["exact", "calibration_gap_mean", None] < 1e-9
    assert found["exact", "executed_minus_predicted_high", None] < 1e-9
    assert found["exact", "executed_error_median", None] < found["exact", "idle_error_median", None]


def test_noise_is_scored_against_the_exact_law_from_the_same_starts():
    scene = gravity()
    task = CellTask("planning", "exact", (0,), TINY)
    recorder = task.recorder(0, scene, "exact")
    score_noise(recorder, scene.law, held_out_question(scene, 16, 0), 0.1, 0)
    found = numbers(task)
    assert found["exact", "over_exact_law", -1.0] == pytest.approx(1.0)
    # Independent errors of a tenth of the deviation are a hundredth of the variance, to begin with.
    assert 0.005 < found["exact", "exact_law_nmse", -1.0] < 0.1


def test_a_planning_cell_leaves_its_numbers(monkeypatch):
    monkeypatch.setattr(planning, "STEPS", 20)
    task = CellTask("planning", "unstructured", (0,), TINY)
    PLANNING.cells["unstructured"](task)
    found = numbers(task)
    assert found["unstructured", "predicted_error_median", None] is not None
    assert found["unstructured/noise-0.3", "regime_match", -1.0] is not None


def test_rolled_positions_repeat_the_parameters_of_their_episodes():
    scene, start, params = free_bodies(2)
    twice = start.map(lambda x: torch.cat([x, x]))
    there = final_position(scene.law, params, scene.dt, twice)
    assert torch.equal(there[:2], there[2:])
    path = rollout(scene.law, start, params, planning.STEPS, scene.dt, planning.STEPS)
    assert torch.equal(there[:2], path.states.q[:, -1, KICKED])
