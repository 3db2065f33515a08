"""Dragged gravity: what a port takes out, and what a conserving model cannot."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from dynamics import HEADS, Head, terms, to_config
from dynamics.terms import HeadTerm
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.dissipation import opposed, score_shed
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.trained import asked_cell
from vidphys.experiments.core.truth import score_truth
from vidphys.runs.records import Recorder
from vidphys.scenes.drag import STRENGTHS, dragged_gravity

PORTS = {
    "port": terms.Drag("linear", "positive"),
    "sign-free": terms.Drag("linear", "free"),
    "factored-port": terms.Drag("linear", "factored"),
}
HEADS_ASKED: dict[str, HeadTerm] = {
    **{name: terms.Hamiltonian(ports=(port,)) for name, port in PORTS.items()},
    "conserving": HEADS["factored"],
    "unstructured": HEADS["unstructured"],
}
CELLS = {"weak": ("port", "conserving"), "strong": tuple(HEADS_ASKED)}
STEPS = 2000


def drag_cell(strength: str, head: str) -> Cell:
    """A cell that trains one head under drag and asks at which rate its energy falls."""

    def ask(task: CellTask, trained: Head, recorder: Recorder, question: Question) -> None:
        score_shed(recorder, trained, question, question.params, STEPS, "shed")
        if head == "factored-port":
            score_shed(recorder, trained, question, opposed(question.params), STEPS, "anti_shed")
        if head == "port":
            score_truth(recorder, question, STEPS)

    return asked_cell(head, HEADS_ASKED[head], partial(dragged_gravity, strength), ask)


def _cells() -> Mapping[str, Cell]:
    asked = [(strength, head) for strength, heads in CELLS.items() for head in heads]
    return {f"{strength}/{head}": drag_cell(strength, head) for strength, head in asked}


DRAG = Table.told(
    "drag",
    cells=_cells(),
    settings={
        "scenes": {name: dragged_gravity(name).settings for name in STRENGTHS},
        "heads": {name: to_config(term) for name, term in HEADS_ASKED.items()},
    },
)
