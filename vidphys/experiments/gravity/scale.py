"""From three bodies to many: the same pair law, asked of more of them."""

from __future__ import annotations

from dataclasses import replace

from dynamics import HEADS, Head, terms, to_config
from dynamics.terms import HeadTerm
from vidphys import metrics
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.oracle import held_out_question
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import forces, score_changed_law, score_drift
from vidphys.experiments.core.trained import Training, smaller_batch, train_cell
from vidphys.experiments.core.truth import score_truth
from vidphys.runs.records import Recorder
from vidphys.scenes.crowd import FEW, crowd

LONG = (3, 8, 16, 32)  # bodies, for 2,000 steps
CURVE = (64, 128, 256, 512, 1024)  # bodies, for a few steps
LONG_STEPS, FEW_STEPS = 2000, 5

ASKED: dict[str, HeadTerm] = {
    "factored": HEADS["factored"],
    "factored-radial": HEADS["factored-radial"],
    "even-coupling": terms.Hamiltonian(potentials=(terms.Radial(coupling="even"),)),
}
FAR = "factored-radial"  # the one that is asked about the whole curve


def episodes_of(bodies: int, held_out: int) -> int:
    """How many episodes of N bodies: about as many bodies in all, and at least one episode."""
    return max(1, min(held_out, held_out * FEW // bodies))


def scale_cell(name: str) -> Cell:
    """A cell that trains one model on three bodies and asks it about more."""

    def run(task: CellTask) -> None:
        world = crowd(FEW)
        how = Training(smaller_batch(2))
        for seed, head, _ in train_cell(task, name, ASKED[name], world, how):
            for bodies in LONG + (CURVE if name == FAR else ()):
                scene = crowd(bodies)
                episodes = episodes_of(bodies, task.sizes.held_out)
                question = held_out_question(scene, episodes, seed)
                recorder = task.recorder(seed, scene, name, str(bodies))
                _ask(recorder, head, question, bodies in LONG)

    return run


def _ask(recorder: Recorder, head: Head, question: Question, long: bool) -> None:
    params = question.params
    score_force(recorder, head, question)
    if not long:
        score_drift(recorder, head, replace(question, every=1), (FEW_STEPS,))
        return
    score_drift(recorder, head, question, (LONG_STEPS,))
    flipped = params.with_coupling(-params.coupling)
    score_changed_law(recorder, head, question, flipped, params, -1.0)


def score_force(recorder: Recorder, head: Head, question: Question) -> None:
    """Force against the truth's at the starts: relative error, and direction."""
    model, true = forces(head, question, question.params)
    error = (model - true).flatten(1).norm(dim=-1) / true.flatten(1).norm(dim=-1)
    recorder.add("force_error_median", metrics.median(error))
    recorder.add("force_cosine", metrics.cosine(model, true))


def truth(task: CellTask) -> None:
    """The reference itself, for each number of bodies that is followed for long."""
    for seed in task.seeds:
        for bodies in LONG:
            scene = crowd(bodies)
            episodes = episodes_of(bodies, task.sizes.held_out)
            question = held_out_question(scene, episodes, seed)
            recorder = task.recorder(seed, scene, "truth", str(bodies))
            score_truth(recorder, question, LONG_STEPS)


N_TRANSFER = Table.told(
    "n-transfer",
    cells={"truth": truth, **{name: scale_cell(name) for name in ASKED}},
    settings={
        "scenes": {str(n): crowd(n).settings for n in (*LONG, *CURVE)},
        "heads": {name: to_config(term) for name, term in ASKED.items()},
    },
)
