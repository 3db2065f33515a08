"""Planning through a model, and starts that are not known exactly."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from dynamics import HEADS, Head, Parameters, PhaseState, rollout, to_config
from vidphys import metrics
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_changed_law
from vidphys.experiments.core.trained import Training, asked_cell, smaller_batch
from vidphys.experiments.core.truth import score_truth
from vidphys.placement import CPU, moved, suited
from vidphys.runs.records import Recorder
from vidphys.scenes import gravity
from vidphys.seeding import derive
from vidphys.shooting.impulse import Plan, kicked, plan_impulse
from vidphys.statistics import normal_interval, paired_difference

MODELS = ("factored", "symplectic", "unstructured")
KICKED = 0  # the body that is pushed and has to reach its target
STEPS = 500  # reference steps from the impulse to the target: 1 s
REACH = 0.3  # world units: standard deviation of the target around where the body would be
BUDGET = 1.5  # momentum units: largest impulse
NOISES = (0.1, 0.2, 0.3)  # of the standard deviation of the states
FLIPPED = -1.0


def model_cell(name: str) -> Cell:
    """A cell that trains one model, plans through it, and starts it from noisy states."""

    def ask(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
        seed = recorder.origin.seed
        score_plans(recorder, head, question, seed)
        for noise in NOISES:
            noisy = task.recorder(seed, question.scene, name, f"noise-{noise:g}")
            score_noise(noisy, head, question, noise, seed)
        if name == MODELS[0]:
            score_truth(recorder, question)

    return asked_cell(name, HEADS[name], gravity, ask, Training(smaller_batch(2)))


def final_position(head: Head, params: Parameters, dt: float, start: PhaseState) -> Tensor:
    """Where the kicked body is after the task's time, in float64; parameters repeat as needed."""
    times = len(start.q) // len(params.coupling)
    law = params.map(lambda x: x.repeat(times, *[1] * (x.dim() - 1)))
    states = rollout(head, *suited((start, law), head), STEPS, dt, STEPS).states
    return moved(states.q[:, -1, KICKED], CPU, torch.float64)


def score_plans(recorder: Recorder, head: Head, question: Question, seed: int) -> None:
    """The error that the model predicts for its plan, and the one that the truth makes."""
    scene, params, start = question.scene, question.params, question.truth
    rng = Generator().manual_seed(derive(seed, "targets"))

    def executed(state: PhaseState) -> Tensor:
        return scene.simulate(state, params, STEPS, STEPS).states.q[:, -1, KICKED]

    alone = executed(start)
    away = REACH * torch.randn(alone.shape, generator=rng, dtype=alone.dtype)
    target = alone + away
    plan = plan_impulse(
        lambda state: final_position(head, params, scene.dt, state), start, target, BUDGET
    )
    reached = executed(kicked(start, plan.impulse))
    _record_plan(recorder, plan, (reached - target).norm(dim=-1), away.norm(dim=-1))


def _record_plan(recorder: Recorder, plan: Plan, executed: Tensor, idle: Tensor) -> None:
    gap = (executed - plan.error).abs()
    for name, values in {
        "predicted_error": plan.error,
        "executed_error": executed,
        "calibration_gap": gap,
        "idle_error": idle,
    }.items():
        recorder.add(f"{name}_median", metrics.median(values))
        recorder.add(f"{name}_mean", metrics.mean(values))
        recorder.add_episodes(name, values)
    finite = torch.isfinite(executed) & torch.isfinite(plan.error)
    lost = int((~finite).sum())
    pairs = executed[finite].tolist(), plan.error[finite].tolist()
    if not pairs[0]:
        return
    for name, interval in {
        "executed_error": normal_interval(pairs[0]),
        "executed_minus_predicted": paired_difference(*pairs),
    }.items():
        if interval.low is not None and interval.high is not None:
            recorder.add(f"{name}_low", metrics.Summary.of(interval.low, len(finite), lost))
            recorder.add(f"{name}_high", metrics.Summary.of(interval.high, len(finite), lost))


def score_noise(
    recorder: Recorder, head: Head, question: Question, noise: float, seed: int
) -> None:
    """The flip from starts with independent errors, and the same of the exact law."""
    rng = Generator().manual_seed(derive(seed, "noise", f"{noise:g}"))

    def blurred(x: Tensor) -> Tensor:
        return x + noise * x.std() * torch.randn(x.shape, generator=rng, dtype=x.dtype)

    start = PhaseState(blurred(question.truth.q), blurred(question.truth.p))
    unsure = Question(question.scene, start, question.truth, question.params)
    flipped = question.params.with_coupling(FLIPPED)
    usual = question.params.with_coupling(-FLIPPED)
    score_changed_law(recorder, head, unsure, flipped, usual, FLIPPED)
    reference = unsure.reference(flipped).states
    exact = question.scene.simulate(start, flipped, unsure.steps, unsure.every).states
    floor = metrics.nmse(exact, reference)
    error = metrics.nmse(unsure.ask(head, unsure.steps, flipped).states, reference)
    recorder.add("exact_law_nmse", floor, FLIPPED, unsure.steps)
    recorder.add("over_exact_law", metrics.ratio(error, floor), FLIPPED, unsure.steps)


PLANNING = Table.told(
    "planning",
    cells={name: model_cell(name) for name in MODELS},
    settings={
        "scene": gravity().settings,
        "heads": {name: to_config(HEADS[name]) for name in MODELS},
        "steps": STEPS,
        "reach": REACH,
        "budget": BUDGET,
    },
)
NOISE = Table.told("noise")
