"""Other families of forces: charges with a held-out sign, and two laws at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from dynamics import HEADS, Head, Parameters, ballistic, terms, to_config
from dynamics.terms import HeadTerm
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.losses import floored
from vidphys.experiments.core.oracle import held_out_question
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import DRIFT_STEPS, score_changed_law, score_drift
from vidphys.experiments.core.trained import Training, asked_cell, smaller_batch
from vidphys.experiments.core.truth import score_truth
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene
from vidphys.scenes.coulomb import all_alike, coulomb, gravity_and_coulomb

Change = Callable[[Parameters], Parameters]

TWINS = {name: HEADS[name] for name in ("symplectic", "unstructured")}
FLOOR = 0.1  # of the momentum increments' spread: charges' forces often cancel


def _heads(*sources: str) -> dict[str, HeadTerm]:
    return {
        "factored": terms.Hamiltonian(potentials=tuple(terms.Displacement(s) for s in sources)),
        "factored-radial": terms.Hamiltonian(potentials=tuple(terms.Radial(s) for s in sources)),
        **TWINS,
    }


CHARGES, TWO_LAWS = _heads("charge"), _heads("mass", "charge")


def flip_gravity(params: Parameters) -> Parameters:
    """G with its sign changed."""
    return params.with_coupling(-params.coupling)


def flip_electric(params: Parameters) -> Parameters:
    """The strength of the charges' law with its sign changed."""
    return params.with_scalar("electric", -params.scalar("electric"))


def flip_both(params: Parameters) -> Parameters:
    """Both strengths with their signs changed."""
    return flip_gravity(flip_electric(params))


HELD_OUT: dict[str, Change] = {"all-repulsive": all_alike, "electric-flipped": flip_electric}
FLIPS: dict[str, Change] = {
    "gravity-flipped": flip_gravity,
    "electric-flipped": flip_electric,
    "both-flipped": flip_both,
}


def family_cell(
    scene: Callable[[], Scene], head: str, term: HeadTerm, changes: Mapping[str, Change]
) -> Cell:
    """A cell that trains one model and asks each changed law of it, each as a part."""

    def ask(task: CellTask, trained: Head, recorder: Recorder, question: Question) -> None:
        score_drift(recorder, trained, question, DRIFT_STEPS)
        score_retrace(recorder, trained, question)
        _ask_changes(task, recorder.origin.seed, head, trained, question, changes)

    return asked_cell(head, term, scene, ask, Training(smaller_batch(2), floored(FLOOR)))


def truth_cell(scene: Callable[[], Scene], changes: Mapping[str, Change]) -> Cell:
    """The reference itself, and the predictor with no force under each changed law."""

    def run(task: CellTask) -> None:
        world = scene()
        for seed in task.seeds:
            question = held_out_question(world, task.sizes.held_out, seed)
            score_truth(task.recorder(seed, world, "truth"), question)
            _ask_changes(task, seed, "ballistic", ballistic(), question, changes)

    return run


def _ask_changes(
    task: CellTask,
    seed: int,
    name: str,
    head: Head,
    question: Question,
    changes: Mapping[str, Change],
) -> None:
    for label, change in changes.items():
        part = task.recorder(seed, question.scene, name, label)
        score_changed_law(part, head, question, change(question.params), question.params)


def _cells(
    scene: Callable[[], Scene], heads: Mapping[str, HeadTerm], changes: Mapping[str, Change]
) -> dict[str, Cell]:
    return {
        "truth": truth_cell(scene, changes),
        **{name: family_cell(scene, name, term, changes) for name, term in heads.items()},
    }


COULOMB = Table.told(
    "coulomb",
    cells=_cells(coulomb, CHARGES, HELD_OUT),
    settings={
        "scene": coulomb().settings,
        "heads": {name: to_config(term) for name, term in CHARGES.items()},
    },
)
MIXED = Table.told(
    "mixed",
    cells=_cells(gravity_and_coulomb, TWO_LAWS, FLIPS),
    settings={
        "scene": gravity_and_coulomb().settings,
        "heads": {name: to_config(term) for name, term in TWO_LAWS.items()},
    },
)
