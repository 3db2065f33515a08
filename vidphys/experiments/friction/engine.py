"""The engine's double pendulum: formalisms, friction, its sign, and time reversal.

All tables read one set of trained models: seven without friction, and four for each law of
friction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from torch import Generator

from dynamics import Head, terms, to_config
from dynamics.terms import Generalised, HeadTerm
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.dissipation import (
    opposed,
    score_divergence,
    score_refusal,
    score_retrace,
    score_shed,
)
from vidphys.experiments.core.members import Examples, one_step
from vidphys.experiments.core.oracle import HORIZON
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_drift, score_inversion
from vidphys.experiments.core.trained import Training, asked_cell, smaller_batch
from vidphys.experiments.core.truth import score_truth
from vidphys.experiments.friction.derivatives import derivative_segments, match_slopes
from vidphys.presets import OracleSizes
from vidphys.runs.records import Recorder
from vidphys.scenes.pendulum import pendulum
from vidphys.scenes.scene import Scene
from vidphys.seeding import derive
from vidphys.training.segments import from_trajectory

WIDTH = 64
HNN = terms.GeneralisedHamiltonian(integrator="tao", width=WIDTH)
SYMODEN = terms.GeneralisedHamiltonian(metric="inverse", integrator="rk4", width=WIDTH)
DELAN = terms.Lagrangian(integrator="rk4", width=WIDTH)
UNSTRUCTURED = terms.Residual(angles=True)
FREE: dict[str, HeadTerm] = {
    "free/hnn-factored": HNN,
    "free/hnn": replace(HNN, factored=False),
    "free/symoden-factored": SYMODEN,
    "free/symoden": replace(SYMODEN, factored=False),
    "free/delan-factored": DELAN,
    "free/delan": replace(DELAN, factored=False),
    "free/unstructured": UNSTRUCTURED,
}
LAWS = ("linear", "square")


def _damped(law: str) -> dict[str, HeadTerm]:
    return {
        f"{law}/port": replace(HNN, ports=(terms.Drag(law, "factored"),)),
        f"{law}/guarantee": replace(HNN, ports=(terms.Drag(law, "guaranteed"),)),
        f"{law}/conserving": HNN,
        f"{law}/unstructured": UNSTRUCTURED,
    }


DAMPED = {name: term for law in LAWS for name, term in _damped(law).items()}
# The cells whose records hold what was checked of the reference, one for each scene.
CERTIFIED = ("free/hnn-factored", *(f"{law}/port" for law in LAWS))
SPREAD = 0.5  # of the friction around its usual value, so that a told one can be learned
SHED_STEPS, ANTI_STEPS, LOST_STEPS = 200, 50, 200
FINE = 5  # steps of a field in a reference step, where anti-friction makes joints fast
SMALLER = 4  # a field is matched on small batches, as many examples in all


def examples(term: HeadTerm, scene: Scene, trajectories: int, seed: int) -> Examples:
    """Short trajectories, the same for every model: derivatives for a field, steps for a map."""
    start, params = scene.sample(trajectories, Generator().manual_seed(derive(seed, "train")))
    trajectory = scene.simulate(start, params, HORIZON)
    is_field = isinstance(term, Generalised)
    segments = derivative_segments(trajectory) if is_field else from_trajectory(trajectory, k=1)
    whole = len(segments) // trajectories
    return Examples(*segments.split(whole * max(1, trajectories // 16)))


def sizes_for(term: HeadTerm, sizes: OracleSizes) -> OracleSizes:
    """A map's budget, or the same number of examples in small batches for a field.

    Rates shrink with the square root of the batch, as the noise of a gradient grows.
    """
    if not isinstance(term, Generalised):
        return sizes
    gentler = tuple(rate / SMALLER**0.5 for rate in sizes.learning_rates)
    steps = SMALLER * sizes.steps
    return replace(smaller_batch(SMALLER)(sizes), steps=steps, learning_rates=gentler)


Score = Callable[[Recorder, Head, Question], None]


def engine_cell(
    term: HeadTerm, scene: Callable[[], Scene], score: Score, certified: bool = False
) -> Cell:
    """A cell that trains one model on a scene of the engine and asks its questions.

    Args:
        term: the model.
        scene: makes the scene.
        score: asks.
        certified: whether what was checked of the reference is recorded here, for all the cells
            of the scene.
    """

    def ask(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
        score(recorder, head, question)
        if certified:
            score_truth(recorder, question)

    loss = match_slopes if isinstance(term, Generalised) else one_step
    how = Training(partial(sizes_for, term), loss, partial(examples, term))
    return asked_cell(None, term, scene, ask, how)


def score_free(recorder: Recorder, head: Head, question: Question) -> None:
    """Another law, a long rollout, and the way back."""
    score_inversion(recorder, head, question)
    score_drift(recorder, head, question)
    score_retrace(recorder, head, question)


def score_damped(recorder: Recorder, head: Head, question: Question) -> None:
    """The rate of loss, the opposite sign of friction, and the way back."""
    score_shed(recorder, head, question, question.params, SHED_STEPS, "shed")
    score_retrace(recorder, head, question)
    against = opposed(question.params)
    if score_refusal(recorder, head, against):
        return
    score_shed(recorder, head, question, against, ANTI_STEPS, "anti_shed", FINE)
    score_divergence(recorder, head, question, LOST_STEPS, FINE)


def _cells() -> Mapping[str, Cell]:
    free = {
        name: engine_cell(term, pendulum, score_free, name in CERTIFIED)
        for name, term in FREE.items()
    }
    damped = {
        name: engine_cell(
            term, partial(pendulum, name.split("/")[0], SPREAD), score_damped, name in CERTIFIED
        )
        for name, term in DAMPED.items()
    }
    return {**free, **damped}


ENGINE = Table.told(
    "engine",
    cells=_cells(),
    settings={
        "scenes": {"free": pendulum().settings}
        | {law: pendulum(law, SPREAD).settings for law in LAWS},
        "heads": {name: to_config(term) for name, term in (FREE | DAMPED).items()},
    },
)
FORMALISMS = Table.told("formalisms")
DISSIPATION = Table.told("engine-dissipation")
ANTI_FRICTION = Table.told("anti-friction")
REVERSAL = Table.told("reversal")
