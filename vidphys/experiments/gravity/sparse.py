"""States far apart in time: which step in the loss lets a model learn the law from them.

A Hamiltonian that is fitted by one step of a symplectic method between two states is not the law,
but the one whose step goes there: the two differ by the error of the step, h^2 of leapfrog and h^4
of Yoshida's method (backward error analysis: Hairer, Lubich & Wanner, *Geometric Numerical
Integration*, 2006, chapter IX). All models are asked in the reference's short steps, so that what
is seen is the law that was learned, not the step that it was learned by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from dynamics import HEADS, Head
from dynamics.terms import Hamiltonian, HeadTerm
from vidphys import metrics
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.oracle import true_segments
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import forces, score_drift, score_inversion
from vidphys.experiments.core.trained import Training, asked_cell, smaller_batch, truth_cell
from vidphys.runs.records import Recorder
from vidphys.scenes import gravity

APART = (5, 10, 20)  # reference steps between stored states: 0.01, 0.02 and 0.04 s
AT_G = -1.0  # the coupling at which the learned force is held to the true one


@dataclass(frozen=True)
class Way:
    """A way to go from one stored state to the next in the loss.

    Args:
        term: of the model, with its method.
        parts: steps of that method.
    """

    term: HeadTerm
    parts: int = 1


def _factored(integrator: str) -> HeadTerm:
    term = HEADS["factored"]
    if not isinstance(term, Hamiltonian):
        raise TypeError("sparse: the factored head has no step to exchange")
    return replace(term, integrator=integrator)


WAYS = {
    "leapfrog": Way(_factored("leapfrog")),
    "leapfrog-in-three": Way(_factored("leapfrog"), parts=3),  # as many forces as Yoshida's
    "yoshida4": Way(_factored("yoshida4")),
    "neural-ode": Way(HEADS["neural-ode"]),  # the twin: a step of Runge and Kutta, four slopes
}


def sparse_cell(way: Way, name: str, apart: int) -> Cell:
    """A cell that trains one model on states so many reference steps apart."""
    examples = partial(true_segments, apart=apart, parts=way.parts)
    how = Training(smaller_batch(2), examples=examples)
    return asked_cell(name, way.term, gravity, _ask, how)


def _ask(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
    score_inversion(recorder, head, question)
    score_drift(recorder, head, question)
    score_force(recorder, head, question)


def score_force(recorder: Recorder, head: Head, question: Question) -> None:
    """Record ``force_nmse``: the learned force at the true starts against the true one.

    At the coupling that no training showed.
    """
    model, true = forces(head, question, question.params.with_coupling(AT_G))
    error = (model - true).square().flatten(1).mean(1) / true.square().mean()
    recorder.add("force_nmse", metrics.mean(error), AT_G)


SPARSE = Table.told(
    "sparse",
    cells={
        f"{name}/{apart}": sparse_cell(way, name, apart)
        for name, way in WAYS.items()
        for apart in APART
    }
    | {"truth": truth_cell(gravity)},
    settings={"apart_steps": list(APART), "parts": {name: w.parts for name, w in WAYS.items()}},
)
