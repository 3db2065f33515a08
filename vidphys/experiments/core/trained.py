"""What most cells begin with: one head for each seed, trained on true states."""

from __future__ import annotations

from dataclasses import replace

from dynamics import Head
from dynamics.terms import HeadTerm
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.members import MemberLoss, one_step, train_members
from vidphys.experiments.core.oracle import true_examples
from vidphys.presets import OracleSizes
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene


def train_cell(
    task: CellTask,
    name: str,
    term: HeadTerm,
    scene: Scene,
    sizes: OracleSizes | None = None,
    loss: MemberLoss = one_step,
    k: int = 1,
    both_signs: bool = False,
    start: str | None = None,
) -> list[tuple[int, Head, Recorder]]:
    """Train a cell's heads side by side.

    Args:
        task: gives seeds, device, checkpoint and progress.
        name: of the head, in the records.
        term, scene: what is built, and on what it is trained.
        sizes: where they differ from the preset's.
        loss: see :func:`vidphys.experiments.core.members.train_members`.
        k, both_signs: see :func:`vidphys.experiments.core.oracle.true_segments`.
        start: name that initial weights and batch order are drawn by, for models that are to
            start alike; the head's own name by default.

    Returns:
        Seed, head and recorder of each training that was not lost; one that was has its record.
    """
    recorders = {seed: task.recorder(seed, scene, name) for seed in task.seeds}
    sizes = task.sizes if sizes is None else sizes
    heads = train_members(
        name if start is None else start,
        lambda: scene.build(term),
        true_examples(scene, sizes.trajectories, task.seeds, k, both_signs),
        sizes,
        recorders,
        loss,
        task.device,
        task.checkpoint("fit"),
        task.progress,
    )
    return [(seed, head, recorders[seed]) for seed, head in heads.items()]


def smaller_batch(sizes: OracleSizes, share: int) -> OracleSizes:
    """The sizes with a ``share``-th of the batch."""
    return replace(sizes, batch=max(1, sizes.batch // share))
