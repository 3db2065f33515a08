"""Stability, inversion and their dissociation: one scene, one set of trained models (N1-N16)."""

from __future__ import annotations

from collections.abc import Callable

from dynamics import HEADS, Terms
from dynamics.build import to_config
from vidphys.experiments.members import MemberLoss, one_step
from vidphys.experiments.oracle import held_out_question, score_oracle, train_on_states
from vidphys.experiments.tables.base import Cell, CellTask, Table
from vidphys.scenes import Scene, gravity

CELLS = (
    "factored",
    "factored-radial",
    "factored-learned-kinetic",
    "symplectic",
    "unstructured",
)


def oracle_cell(
    name: str, terms: Terms, scene: Callable[[], Scene] = gravity, loss: MemberLoss = one_step
) -> Cell:
    """A cell that trains one head on true states and asks both questions of it."""

    def run(task: CellTask) -> None:
        world = scene()
        recorders = {seed: task.recorder(seed, world, name) for seed in task.seeds}
        heads = train_on_states(
            name,
            terms,
            world,
            task.sizes,
            recorders,
            loss,
            task.device,
            task.checkpoint("fit"),
            task.progress,
        )
        for seed, head in heads.items():
            question = held_out_question(world, task.sizes.held_out, seed)
            score_oracle(recorders[seed], head, question)

    return run


STABILITY = Table(
    name="stability",
    title="Stability: does the energy of a long rollout hold?",
    about=(
        "Three bodies under softened gravity, trained one step ahead on G > 0. The drift of the "
        "true energy along 2,000 and 10,000 predicted steps, for models with and without a "
        "conserved energy."
    ),
    ids="N1-N9",
    cells={name: oracle_cell(name, HEADS[name]) for name in CELLS},
    settings={
        "scene": gravity().settings,
        "heads": {name: to_config(HEADS[name]) for name in CELLS},
    },
)
INVERSION = Table(
    name="inversion",
    title="Inversion: is a changed law answered?",
    about=(
        "The same trained models, asked what happens when the coupling changes sign, which no "
        "training trajectory shows."
    ),
    ids="N10-N16",
    source="stability",
)
