"""Laws that a model is wrong about, and whether it can be told beforehand."""

from __future__ import annotations

from collections.abc import Callable

from dynamics import Head, terms, to_config
from vidphys.coupling_power import coupling_power, measured_forces
from vidphys.coupling_verdict import CONTRADICTED, SUPPORTED, UNDECIDED
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.oracle import true_trajectories
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_inversion
from vidphys.experiments.core.trained import Training, asked_cell, smaller_batch
from vidphys.experiments.core.truth import score_truth
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene
from vidphys.scenes.changed_laws import gravity_of_power, three_body_gravity

RECORDED = 256  # training trajectories that the coupling-power test is given
WORLDS: dict[str, Callable[[], Scene]] = {
    "linear": lambda: gravity_of_power("linear"),
    "even": lambda: gravity_of_power("even"),
    "quadratic": lambda: gravity_of_power("quadratic"),
    "three-body": three_body_gravity,
}
POTENTIALS: dict[str, tuple[terms.Pair] | tuple[terms.Pair, terms.Triple]] = {
    "factored": (terms.Displacement(),),
    "factored-even": (terms.Displacement(coupling="even"),),
    "factored-squared": (terms.Displacement(coupling="quadratic"),),
    "factored-triples": (terms.Displacement(), terms.Triple()),
}
PRIORS = {name: terms.Hamiltonian(potentials=parts) for name, parts in POTENTIALS.items()}
SERIES = {
    "linear": ("factored",),
    "even": ("factored", "factored-even"),
    "quadratic": ("factored", "factored-squared"),
    "three-body": ("factored", "factored-triples"),
}


def series_cell(world: str, prior: str) -> Cell:
    """A cell that trains one prior in one world, and asks what the training data support."""

    def ask(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
        count, seed = task.sizes.trajectories, recorder.origin.seed
        ask_power(recorder, question.scene, POTENTIALS[prior][0].coupling, count, seed)
        score_inversion(recorder, head, question)
        if prior == "factored":
            score_truth(recorder, question)

    return asked_cell(prior, PRIORS[prior], WORLDS[world], ask, Training(smaller_batch(2)))


def ask_power(recorder: Recorder, scene: Scene, assumed: str, trajectories: int, seed: int) -> None:
    """What the training data, all at G > 0, say of the power that a model assumes.

    ``warned`` is 1 where the assumed power is not the only one that the data support.
    """
    recorded = true_trajectories(scene, min(trajectories, RECORDED), seed)
    verdict = coupling_power(measured_forces(recorded))
    standing = verdict.of(assumed)
    recorder.add_value("power_warned", float(standing != SUPPORTED))
    recorder.add_value("power_undecided", float(standing == UNDECIDED))
    recorder.add_value("power_contradicted", float(standing == CONTRADICTED))
    recorder.add_value("power_unexplained", min(verdict.unexplained.values()))
    if verdict.query is not None:
        recorder.add_value("power_query", verdict.query)


def _settings() -> dict[str, object]:
    return {
        "scenes": {name: world().settings for name, world in WORLDS.items()},
        "heads": {name: to_config(term) for name, term in PRIORS.items()},
    }


MISSPECIFICATION = Table.told(
    "misspecification",
    cells={
        f"{world}-{prior}": series_cell(world, prior)
        for world, priors in SERIES.items()
        for prior in priors
    },
    settings=_settings(),
)
