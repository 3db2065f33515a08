"""What most cells are: one head for each seed, trained on true states, and then asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from dynamics import Head
from dynamics.terms import HeadTerm
from vidphys.experiments.core.cell import Cell, CellTask
from vidphys.experiments.core.members import Examples, MemberLoss, one_step, train_members
from vidphys.experiments.core.oracle import held_out_question, true_segments
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import DRIFT_STEPS
from vidphys.experiments.core.truth import score_truth
from vidphys.presets import OracleSizes
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene

Ask = Callable[[CellTask, Head, Recorder, Question], None]
MakeQuestion = Callable[[Scene, int, int], Question]  # of a scene, episodes and a seed


def smaller_batch(share: int) -> Callable[[OracleSizes], OracleSizes]:
    """The sizes with a ``share``-th of the batch."""
    return lambda sizes: replace(sizes, batch=max(1, sizes.batch // share))


@dataclass(frozen=True)
class Training:
    """How a cell's heads are trained.

    Args:
        sizes: made of the preset's.
        loss: see :func:`vidphys.experiments.core.members.train_members`.
        examples: of a scene, a number of trajectories and a seed.
        start: name that initial weights and batch order are drawn by, for models that are to
            start alike; the head's own name by default.
        checkpoint: its name.
    """

    sizes: Callable[[OracleSizes], OracleSizes] = smaller_batch(1)
    loss: MemberLoss = one_step
    examples: Callable[[Scene, int, int], Examples] = true_segments
    start: str | None = None
    checkpoint: str = "fit"


USUAL = Training()  # one step ahead


def train_cell(
    task: CellTask, name: str, term: HeadTerm, scene: Scene, how: Training = USUAL, **seen: Any
) -> list[tuple[int, Head, Recorder]]:
    """Train a cell's heads side by side.

    Args:
        task: gives seeds, device, checkpoint and progress.
        name: of the head, in the records.
        term, scene: what is built, and on what it is trained.
        how: see :class:`Training`.
        seen: how states are, for the record; see :meth:`CellTask.recorder`.

    Returns:
        Seed, head and recorder of each training that was not lost; one that was has its record.
    """
    recorders = {seed: task.recorder(seed, scene, name, **seen) for seed in task.seeds}
    sizes = how.sizes(task.sizes)

    def examples() -> dict[int, Examples]:
        return {seed: how.examples(scene, sizes.trajectories, seed) for seed in task.seeds}

    heads = train_members(
        name if how.start is None else how.start,
        lambda: scene.build(term),
        task.kept.once("examples", (scene.name, how.examples, task.seeds), examples),
        sizes,
        recorders,
        how.loss,
        task.device,
        task.checkpoint(how.checkpoint),
        task.progress,
    )
    return [(seed, head, recorders[seed]) for seed, head in heads.items()]


def asked_cell(
    name: str | None,
    term: HeadTerm,
    scene: Callable[[], Scene],
    ask: Ask,
    how: Training = USUAL,
    question: MakeQuestion = held_out_question,
) -> Cell:
    """A cell that trains one model and asks it; without a name the model is called as the cell."""

    def run(task: CellTask) -> None:
        world = scene()
        for seed, head, recorder in train_cell(task, name or task.cell, term, world, how):
            ask(task, head, recorder, question(world, task.sizes.held_out, seed))

    return run


def truth_cell(
    scene: Callable[[], Scene],
    steps: int = DRIFT_STEPS[-1],
    question: MakeQuestion = held_out_question,
) -> Cell:
    """The reference itself."""

    def run(task: CellTask) -> None:
        world = scene()
        for seed in task.seeds:
            asked = question(world, task.sizes.held_out, seed)
            score_truth(task.recorder(seed, world, "truth"), asked, steps)

    return run
