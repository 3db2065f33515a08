"""The oracle-state tables of three bodies under gravity: one set of trained models, many questions.

Stability, inversion, their dissociation, graph networks, stronger baselines and parameter
extrapolation all ask the models of the ``stability`` table.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch

from dynamics import HEADS, Head, PhaseState, ballistic, to_config
from dynamics.terms import HeadTerm
from vidphys import metrics
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.losses import energy_penalised, noisy
from vidphys.experiments.core.members import MemberLoss, one_step
from vidphys.experiments.core.oracle import held_out_question, true_segments
from vidphys.experiments.core.question import INVERSION_STEPS, Question
from vidphys.experiments.core.scoring import (
    DRIFT_STEPS,
    LONG_STEPS,
    score_drift,
    score_inversion,
    score_long_drift,
    score_rollout_error,
)
from vidphys.experiments.core.trained import Training, asked_cell, smaller_batch
from vidphys.experiments.core.truth import score_truth
from vidphys.runs.records import Recorder
from vidphys.scenes import gravity

NOISE = 3e-3  # of the state's standard deviation, the study's training-noise variant
AHEAD = 5  # steps of the multi-step variant
COUPLINGS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0)  # trained: 0.5 to 1.5
MASSES = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0)  # trained: 0.5 to 1.5
SHORT = 50  # steps of the study's short horizon


@dataclass(frozen=True)
class Recipe:
    """How one model of the table is trained.

    Args:
        terms: of the model.
        loss: see :mod:`vidphys.experiments.core.losses`.
        k: steps of a training segment; the batch shrinks in proportion.
        both_signs: domain randomisation over the sign of G.
        long: whether 10,000 steps are asked for.
    """

    term: HeadTerm
    loss: MemberLoss = one_step
    k: int = 1
    both_signs: bool = False
    long: bool = False


RECIPES = {
    "factored": Recipe(HEADS["factored"], long=True),
    "factored-radial": Recipe(HEADS["factored-radial"], long=True),
    "factored-learned-kinetic": Recipe(HEADS["factored-learned-kinetic"]),
    "factored-multi-step": Recipe(HEADS["factored"], k=AHEAD),
    "symplectic": Recipe(HEADS["symplectic"], long=True),
    "unstructured": Recipe(HEADS["unstructured"]),
    "energy-penalised-1": Recipe(HEADS["unstructured"], energy_penalised(gravity(), 1.0)),
    "energy-penalised-100": Recipe(HEADS["unstructured"], energy_penalised(gravity(), 100.0)),
    "neural-ode": Recipe(HEADS["neural-ode"]),
    "gns": Recipe(HEADS["gns"]),
    "gns-noise": Recipe(HEADS["gns"], noisy(NOISE)),
    "factored-gns": Recipe(HEADS["factored-gns"]),
    "factored-gns-noise": Recipe(HEADS["factored-gns"], noisy(NOISE)),
    "set-transformer": Recipe(HEADS["set-transformer"]),
    "domain-randomised": Recipe(HEADS["unstructured"], both_signs=True),
}


def recipe_cell(recipe: Recipe) -> Cell:
    """A cell that trains one model on true states and asks all questions of it."""

    def ask(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
        rolled = question.ask(head, LONG_STEPS if recipe.long else DRIFT_STEPS[-1])
        score_inversion(recorder, head, question, rolled)
        score_short_inversion(recorder, head, question)
        score_drift(recorder, head, question, rolled=rolled)
        score_retrace(recorder, head, question)
        score_rollout_error(recorder, question, rolled)
        score_extrapolation(recorder, head, question)
        if recipe.long:
            score_long_drift(recorder, head, question, rolled)

    segments = partial(true_segments, k=recipe.k, both_signs=recipe.both_signs)
    # As many force evaluations for k steps as for one.
    how = Training(smaller_batch(recipe.k), recipe.loss, segments)
    return asked_cell(None, recipe.term, gravity, ask, how)


def truth(task: CellTask) -> None:
    """The reference itself: certificates, Lyapunov time, and the predictor with no force."""
    scene = gravity()
    for seed in task.seeds:
        recorder = task.recorder(seed, scene, "ballistic")
        question = held_out_question(scene, task.sizes.held_out, seed)
        score_inversion(recorder, ballistic(), question)
        score_truth(recorder, question)


def score_short_inversion(recorder: Recorder, head: Head, question: Question) -> None:
    """The study's 50-step reading: does it invert before errors have grown?"""
    short = Question(question.scene, question.start, question.truth, question.params, SHORT)
    changed = question.params.with_coupling(-1.0)
    predicted = short.ask(head, SHORT, changed).states
    reference = short.reference(changed).states
    usual = short.reference(question.params.with_coupling(1.0)).states
    error = metrics.nmse(predicted, reference)
    floor = metrics.nmse(short.straight_lines().states, reference)
    recorder.add("inversion_nmse", error, -1.0, SHORT)
    recorder.add("ballistic_skill", metrics.ratio(error, floor), -1.0, SHORT)
    recorder.add("regime_match", metrics.regime_match(predicted, reference, usual), -1.0, SHORT)


def score_extrapolation(recorder: Recorder, head: Head, question: Question) -> None:
    """Error of one stored step at laws inside and outside the training band.

    The error is that of the momentum gained over the step against the true gain's size, so that
    stronger laws are not worse for being stronger.
    """
    scene, params = question.scene, question.params
    for value in COUPLINGS:
        error = _step_error(head, question, params.with_coupling(value))
        recorder.add("step_error_coupling", error, value)
    for value in MASSES:
        mass = torch.full_like(params.mass, value)
        changed = type(params)(params.coupling, mass)
        start = PhaseState(question.truth.q, mass.unsqueeze(-1) * _velocity(question))
        moved = Question(scene, start, start, changed)
        recorder.add("step_error_mass", _step_error(head, moved, changed), value)


def _velocity(question: Question) -> torch.Tensor:
    return question.truth.p / question.params.mass.unsqueeze(-1)


def _step_error(head: Head, question: Question, params) -> metrics.Summary:  # noqa: ANN001
    steps = question.every
    predicted = question.ask(head, steps, params).at(-1).p.double()
    truth = question.scene.simulate(question.truth, params, steps, steps).at(-1).p
    gained = (truth - question.truth.p.double()).square().sum((1, 2))
    error = (predicted - truth).square().sum((1, 2))
    return metrics.median((error / gained).sqrt())


STABILITY = Table.told(
    "stability",
    cells={"truth": truth, **{name: recipe_cell(r) for name, r in RECIPES.items()}},
    settings={
        "scene": gravity().settings,
        "heads": {name: to_config(r.term) for name, r in RECIPES.items()},
        "training_noise": NOISE,
        "multi_step": AHEAD,
        "inversion_steps": INVERSION_STEPS,
    },
)
INVERSION = Table.told("inversion")
DISSOCIATION = Table.told("dissociation")
GRAPH_NETS = Table.told("graph-nets")
BASELINES = Table.told("baselines")
EXTRAPOLATION = Table.told("extrapolation")
