"""What most cells begin with: one head for each seed, trained on true states."""

from __future__ import annotations

from dataclasses import replace

from dynamics import Head, Terms
from vidphys.experiments.members import MemberLoss, one_step
from vidphys.experiments.oracle import train_on_states
from vidphys.experiments.tables.base import CellTask
from vidphys.presets import OracleSizes
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene


def train_cell(
    task: CellTask,
    name: str,
    terms: Terms,
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
        terms, scene: what is built, and on what it is trained.
        sizes: where they differ from the preset's.
        loss, k, both_signs: see :func:`vidphys.experiments.oracle.train_on_states`.
        start: name that initial weights and batch order are drawn by, for models that are to
            start alike; the head's own name by default.

    Returns:
        Seed, head and recorder of each training that was not lost; one that was has its record.
    """
    recorders = {seed: task.recorder(seed, scene, name) for seed in task.seeds}
    heads = train_on_states(
        name if start is None else start,
        terms,
        scene,
        task.sizes if sizes is None else sizes,
        recorders,
        loss,
        task.device,
        task.checkpoint("fit"),
        task.progress,
        k,
        both_signs,
    )
    return [(seed, head, recorders[seed]) for seed, head in heads.items()]


def smaller_batch(sizes: OracleSizes, share: int) -> OracleSizes:
    """The sizes with a ``share``-th of the batch."""
    return replace(sizes, batch=max(1, sizes.batch // share))
