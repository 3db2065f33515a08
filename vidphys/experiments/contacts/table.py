"""Disks that touch softly, stiffly or without any give."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import torch
from torch import Generator

from dynamics import Head, PhaseState, terms, to_config
from dynamics.events import HardDisks
from dynamics.terms import HeadTerm
from vidphys import metrics
from vidphys.experiments.contacts.training import collision_loss, stretches
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.oracle import AGES, OLDEST
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import DRIFT_STEPS, score_changed_law, score_drift
from vidphys.experiments.core.trained import Training, asked_cell, smaller_batch, truth_cell
from vidphys.presets import OracleSizes
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene
from vidphys.scenes.torus import BOX, LEVELS, STIFFNESS, disks
from vidphys.seeding import derive

PAIRS = terms.Hamiltonian(potentials=(terms.Knots("alike"),), box=BOX)
HEADS: dict[str, HeadTerm] = {
    "factored": PAIRS,
    "factored-network": replace(PAIRS, potentials=(terms.Displacement("alike"),)),
    "restitution": replace(PAIRS, ports=(terms.Restitution(),)),
    "free-impulse": replace(PAIRS, potentials=(terms.NoPotential(),), ports=(terms.FreeImpulse(),)),
    "symplectic": terms.HEADS["symplectic"],
    "unstructured": terms.HEADS["unstructured"],
}
EVENTS = terms.HardDisks(BOX)
RETRACE_STEPS = 1000
FEW = Training(smaller_batch(4))  # for every model alike: there are many models
SCALARS_FASTER = 10  # a single number is learned at so many times a network's rate
UNDEFINED = "undefined"


def cell(level: str, head: str) -> Cell:
    """A cell that trains one model on one level of stiffness and asks all questions of it."""
    return asked_cell(head, HEADS[head], partial(disks, level), _ask, FEW, aged_question)


def _ask_events(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
    assert isinstance(head, HardDisks)
    recorder.add_value("diameter", float(head.diameter.detach()))
    _ask(task, head, recorder, question)


def event_cell() -> Cell:
    """Hard disks by their events: the only learned number is the diameter."""

    def faster(sizes: OracleSizes) -> OracleSizes:
        rates = tuple(SCALARS_FASTER * rate for rate in sizes.learning_rates)
        return replace(FEW.sizes(sizes), learning_rates=rates)

    how = Training(faster, collision_loss, stretches)
    return asked_cell(
        "events", EVENTS, partial(disks, "impulsive"), _ask_events, how, aged_question
    )


def aged_question(scene: Scene, episodes: int, seed: int) -> Question:
    """Held-out episodes of any age that training has, so that some disks are in touch."""
    rng = Generator().manual_seed(derive(seed, "test"))
    start, params = scene.sample(episodes, rng)
    past = scene.simulate(start, params, OLDEST, OLDEST // AGES).states
    age = torch.randint(AGES + 1, (episodes,), generator=rng)
    start = past[torch.arange(episodes), age]
    return Question(scene, start, start, params)


def _ask(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
    rolled = score_drift(recorder, head, question, DRIFT_STEPS)
    _score_momentum(recorder, rolled.states)
    score_retrace(recorder, head, replace(question, steps=RETRACE_STEPS))
    _score_held_law(recorder, head, question)
    if task.cell.partition("/")[0] in STIFFNESS:
        flipped = question.params.with_coupling(-question.params.coupling)
        score_changed_law(recorder, head, question, flipped, question.params, -1.0)
    else:
        # Hard disks have no stiffness whose sign could be changed.
        none = metrics.Summary(None, UNDEFINED, task.sizes.held_out, 0)
        recorder.add("inversion_nmse", none, -1.0, question.steps)


def _score_held_law(recorder: Recorder, head: Head, question: Question) -> None:
    """Does the model see the contacts at all? Low drift alone does not say so."""
    predicted = question.ask(head, question.steps).states
    reference = question.reference(question.params).states
    error = metrics.nmse(predicted, reference)
    floor = metrics.nmse(question.straight_lines().states, reference)
    recorder.add("in_distribution_nmse", error, None, question.steps)
    recorder.add("in_distribution_skill", metrics.ratio(error, floor), None, question.steps)


def _score_momentum(recorder: Recorder, states: PhaseState) -> None:
    """Largest change of the total momentum, relative to the sum of the bodies' own at the start."""
    total = states.p.double().sum(-2)
    scale = states.p[:, 0].double().norm(dim=-1).sum(-1)
    change = (total - total[:, :1]).norm(dim=-1).amax(1) / scale
    recorder.add("momentum_change_worst", metrics.worst(change))


def _cells() -> dict[str, Cell]:
    cells: dict[str, Cell] = {}
    for level in LEVELS:
        cells[f"{level}/truth"] = truth_cell(partial(disks, level), question=aged_question)
        for head in HEADS:
            # Without a stiffness there is no inversion that the non-factored twin could be asked.
            if head != "symplectic" or level in STIFFNESS:
                cells[f"{level}/{head}"] = cell(level, head)
    return cells | {"impulsive/events": event_cell()}


CONTACTS = Table.told(
    "contacts",
    cells=_cells(),
    settings={
        "scenes": {level: disks(level).settings for level in LEVELS},
        "heads": {name: to_config(term) for name, term in {**HEADS, "events": EVENTS}.items()},
    },
)
