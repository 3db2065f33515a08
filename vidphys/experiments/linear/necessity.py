"""A free force beside the factored one: is it taken, and does a penalty send it back?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from dynamics import Head, terms, to_config
from dynamics.hybrid import shortcut_share
from dynamics.terms import HeadTerm, PortTerm, PotentialTerm
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.dissipation import score_retrace, score_shed
from vidphys.experiments.core.losses import floored, shortcut_penalised
from vidphys.experiments.core.members import MemberLoss
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import DRIFT_STEPS, score_changed_law, score_drift
from vidphys.experiments.core.trained import Training, asked_cell, smaller_batch, truth_cell
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene
from vidphys.scenes.drag import dragged_gravity
from vidphys.scenes.springs import springs

STEPS = DRIFT_STEPS[-1]
FLOOR = 0.1  # of the momentum increments' spread: beyond the cutoff there is no force at all
ONE = 5.0  # the stiffness where there is only one
WEAK, STRONG = 1.0, 100.0  # weights of the penalty
STRENGTH = "strong"  # of the drag

GRAVITY = terms.Displacement()
PORT = (terms.Drag("linear", "positive"),)


@dataclass(frozen=True)
class Recipe:
    """One model of these tables.

    Args:
        scene: where it is trained and asked.
        pair, ports: of the model.
        weight: of the penalty on the shortcut; ``None`` for a model that has none.
        floor: least size that momentum errors are relative to, see
            :func:`vidphys.experiments.core.losses.floored`; drag is seen in small increments.
    """

    scene: Callable[[], Scene]
    pair: PotentialTerm
    ports: tuple[PortTerm, ...] = ()
    weight: float | None = None
    floor: float = 0.0

    @property
    def term(self) -> HeadTerm:
        """The model."""
        potential = self.pair if self.weight is None else terms.Shortcut((self.pair,))
        return terms.Hamiltonian(potentials=(potential,), ports=self.ports)

    @property
    def loss(self) -> MemberLoss:
        """What it is trained by."""
        if self.weight is None:
            return floored(self.floor)
        return shortcut_penalised(self.weight, self.floor)


def one_stiffness() -> Scene:
    """Springs of one stiffness: data in which nothing tells a coupling from a constant."""
    return springs((ONE, ONE))


def strong_drag() -> Scene:
    """Gravity with drag of one strength."""
    return dragged_gravity(STRENGTH)


def _screen(scene: Callable[[], Scene], weight: float | None) -> Recipe:
    return Recipe(scene, terms.Displacement("alike"), (), weight, FLOOR)


SCREEN = {
    "one-stiffness/no-shortcut": _screen(one_stiffness, None),
    "one-stiffness/free": _screen(one_stiffness, 0.0),
    "one-stiffness/weak-penalty": _screen(one_stiffness, WEAK),
    "one-stiffness/strong-penalty": _screen(one_stiffness, STRONG),
    "many-stiffnesses/free": _screen(springs, 0.0),
}
UNDER_DRAG = {
    "port": Recipe(strong_drag, GRAVITY, PORT),
    "port-and-shortcut": Recipe(strong_drag, GRAVITY, PORT, 0.0),
    "port-and-penalty": Recipe(strong_drag, GRAVITY, PORT, STRONG),
    "penalty-without-port": Recipe(strong_drag, GRAVITY, (), STRONG),
}


def hybrid_cell(recipe: Recipe) -> Cell:
    """A cell that trains one model and asks for its shortcut's share and the flipped coupling."""

    def ask(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
        _ask(recorder, head, recipe, question)

    # There are two networks in a model; and the models of a table start alike.
    how = Training(smaller_batch(2), recipe.loss, start="hybrid")
    return asked_cell(None, recipe.term, recipe.scene, ask, how)


def _ask(recorder: Recorder, head: Head, recipe: Recipe, question: Question) -> None:
    params = question.params
    flipped = params.with_coupling(-params.coupling)
    score_changed_law(recorder, head, question, flipped, params, -1.0)
    if "friction" in params.scalars:
        score_shed(recorder, head, question, params, STEPS, "shed")
    else:
        score_drift(recorder, head, question, DRIFT_STEPS)
        score_retrace(recorder, head, question)
    if recipe.weight is not None:
        state, law = question.truth.map(torch.Tensor.float), params.map(torch.Tensor.float)
        with torch.no_grad():
            recorder.add_value("shortcut_share", float(shortcut_share(head, state, law)))


NECESSITY = Table.told(
    "necessity",
    cells={
        "truth": truth_cell(one_stiffness),
        **{name: hybrid_cell(recipe) for name, recipe in SCREEN.items()},
    },
    settings={
        "scene": one_stiffness().settings,
        "heads": {name: to_config(recipe.term) for name, recipe in SCREEN.items()},
        "weights": {name: recipe.weight for name, recipe in SCREEN.items()},
    },
)
COMPOSITION = Table.told(
    "composition",
    cells={
        "truth": truth_cell(strong_drag),
        **{name: hybrid_cell(recipe) for name, recipe in UNDER_DRAG.items()},
    },
    settings={
        "scene": strong_drag().settings,
        "heads": {name: to_config(recipe.term) for name, recipe in UNDER_DRAG.items()},
        "weights": {name: recipe.weight for name, recipe in UNDER_DRAG.items()},
    },
)
