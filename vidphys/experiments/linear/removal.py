"""Terms of a trained model taken out, turned round or exchanged, and asked what then happens.

No training shows any of it. A term that was learned as a part can be changed alone; a model
without parts has nothing to change but the coupling that it is told, and goes on as before.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

from dynamics import HEADS, Hamiltonian, Head, terms, to_config
from dynamics.contact import CutSpring
from dynamics.couplings import PairLaw
from dynamics.terms import HeadTerm
from vidphys import metrics
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.oracle import held_out_question
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.trained import Training, asked_cell, train_cell, truth_cell
from vidphys.presets import OracleSizes
from vidphys.reading.laws import PAIR, Law
from vidphys.runs.records import Recorder
from vidphys.scenes.many_terms import many_terms
from vidphys.scenes.springs import CUTOFF, springs

ALIKE = PairLaw("alike")
MODELS: Mapping[str, HeadTerm] = {
    "parts": terms.Hamiltonian(
        potentials=(terms.Displacement(), terms.Uniform(), terms.Trap(1.0, learned=True)),
        ports=(terms.Drag("linear", "positive"),),
    ),
    "unstructured": HEADS["unstructured"],
    "springs": terms.Hamiltonian(potentials=(terms.Displacement("alike"),)),
}
STEPS = 500  # reference steps: drag needs a second to be seen
STIFF = 5.0  # of the springs that take the place of gravity
NOTHING = "nothing-changed"
CHANGES: Mapping[str, Mapping[str, float]] = {
    NOTHING: {},
    "pair-removed": {PAIR: 0.0},
    "pair-flipped": {PAIR: -1.0},
    "field-removed": {"gravity": 0.0},
    "field-flipped": {"gravity": -1.0},
    "trap-removed": {"stiffness": 0.0},
    "drag-removed": {"friction": 0.0},
    "drag-tripled": {"friction": 3.0},
    "all-but-pair-removed": {"gravity": 0.0, "stiffness": 0.0, "friction": 0.0},
}


def more_steps(sizes: OracleSizes) -> OracleSizes:
    """As many examples in four times the steps: each takes a single number only so far."""
    return replace(sizes, steps=4 * sizes.steps, batch=max(1, sizes.batch // 4))


def removal_cell(name: str) -> Cell:
    """A cell that trains one model under all terms and asks it about each change, a part each."""

    def ask(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
        usual = replace(question, steps=STEPS)
        for change, factors in CHANGES.items():
            part = task.recorder(recorder.origin.seed, usual.scene, name, change)
            score_change(part, *changed(head, usual, factors), usual)

    return asked_cell(name, MODELS[name], many_terms, ask, Training(more_steps))


def changed(head: Head, usual: Question, factors: Mapping[str, float]) -> tuple[Head, Question]:
    """A head and its question with numbers of the law multiplied.

    A head that lacks one of them is left as it is.
    """
    scene = usual.scene
    truth = Law(cast(Hamiltonian, scene.law), usual.params).changed(factors)
    law = cast(Hamiltonian, truth.head)
    asked = replace(usual, scene=replace(scene, law=law), params=truth.params)
    own = Law(head, usual.params)
    has = all(name in own.quantities for name in factors)
    return (own.changed(factors).head if has else head), asked


def score_change(recorder: Recorder, head: Head, asked: Question, usual: Question) -> None:
    """Error of an answer to a changed law, and what share of the change it misses.

    Args:
        recorder: gets ``inversion_nmse``, ``truth_distance`` (the error of the usual law's truth)
            and ``change_missed``, the first over the second.
        head: is asked, changed already where it can be.
        asked: about the changed law, by its scene and parameters.
        usual: the same starts under the law that was trained on.
    """
    truth = asked.reference(asked.params).states
    error = metrics.nmse(asked.ask(head, STEPS).states, truth)
    recorder.add("inversion_nmse", error, None, STEPS)
    distance = metrics.nmse(usual.reference(usual.params).states, truth)
    if distance.value:  # none where nothing was changed
        recorder.add("truth_distance", distance, None, STEPS)
        recorder.add("change_missed", metrics.ratio(error, distance), None, STEPS)


def run_exchanged(task: CellTask) -> None:
    """The pair law of a model of springs takes the place of gravity's."""
    world, other = many_terms(), many_terms(CutSpring(CUTOFF, ALIKE))
    lent = {
        seed: head
        for seed, head, _ in train_cell(
            task,
            "springs",
            MODELS["springs"],
            springs(),
            Training(more_steps, checkpoint="fit-springs"),
        )
    }
    how = Training(more_steps, checkpoint="fit-parts")
    for seed, head, recorder in train_cell(task, "parts", MODELS["parts"], world, how):
        if seed not in lent:
            continue  # its record says that the training was lost
        usual = replace(held_out_question(world, task.sizes.held_out, seed), steps=STEPS)
        asked = replace(usual, scene=other, params=usual.params.with_coupling(STIFF))
        score_change(recorder, exchanged(head, lent[seed]), asked, usual)


def exchanged(head: Head, lender: Head) -> Head:
    """A head of parts with another head's pair law in place of its own."""
    new: Any = copy.deepcopy(head)
    new.potential.parts[0] = cast(Any, lender).potential
    return new


REMOVAL = Table.told(
    "removal",
    cells={
        "truth": truth_cell(many_terms, STEPS),
        "parts": removal_cell("parts"),
        "unstructured": removal_cell("unstructured"),
        "exchanged": run_exchanged,
    },
    settings={
        "scene": many_terms().settings,
        "heads": {name: to_config(term) for name, term in MODELS.items()},
        "changes": CHANGES,
        "stiffness": STIFF,
    },
)
