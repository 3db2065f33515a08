"""What most pixel tables begin with: clips are drawn and seen, and heads trained on the tracks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from vidphys.experiments.core.cell import Cell, CellTask
from vidphys.experiments.core.scoring import Question, score_lost
from vidphys.experiments.ladder import pixel_scene
from vidphys.experiments.pixels.seen import (
    Perceived,
    Seen,
    draw,
    fit_perception,
    perceive,
    train_and_score,
)
from vidphys.perception.base import Grounding
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene

SHOOTING = "shooting"
Also = Callable[[Recorder, Question], None]


@dataclass(frozen=True)
class Watcher:
    """One seed's clips of a cell, on their way to a trained head.

    Args:
        task: of the cell.
        seed: one of its seeds.
        scene: what is filmed.
        grounding: how it is perceived.
        seen: the clips.
    """

    task: CellTask
    seed: int
    scene: Scene
    grounding: Grounding
    seen: Seen

    def perceive(self, head: str) -> Perceived:
        """Tracks of the clips, by a perception that is fitted here."""
        task = self.task
        perception = fit_perception(
            self.grounding,
            self.seen,
            task.pixel,
            self.seed,
            head,
            self.folder("perception"),
            task.progress,
        )
        return perceive(perception, self.seen)

    def score(self, perceived: Perceived, head: str, readout: str, part: str, also: Also) -> None:
        """Train a head on the tracks and score it; a training that diverged is counted."""
        g, task = self.grounding, self.task
        cell = task.recorder(self.seed, self.scene, head, part, g.name, g.encoder, g.binder)
        recorder = cell.reading(readout)
        try:
            _, question, _ = train_and_score(
                readout,
                head,
                self.scene,
                self.seen,
                perceived,
                task.pixel,
                self.seed,
                recorder,
                self.folder(part),
                task.progress,
            )
        except FloatingPointError:
            score_lost(recorder, task.pixel.held_out)
        else:
            also(recorder, question)

    def folder(self, name: str) -> Path | None:
        """Where checkpoints of a stage lie."""
        if self.task.folder is None:
            return None
        return self.task.folder / f"s{self.seed}-{name.replace('/', '-')}"


def seen_cell(
    grounding: Grounding,
    heads: Sequence[str],
    scene: Callable[[], Scene] = pixel_scene,
    readouts: Sequence[str] = (SHOOTING,),
    also: Also = lambda recorder, question: None,
) -> Cell:
    """A cell that fits one perception for each seed and trains each head on what it sees.

    Each head is a part ``CELL/HEAD``, or ``CELL/HEAD/READOUT`` where there are several readouts.

    Args:
        grounding: how states are perceived; a joint one is fitted again for each head.
        heads: names in ``dynamics.HEADS``.
        scene: what is filmed.
        readouts: of the start at t0, and of how heads are trained.
        also: records more of the perceived start.
    """

    def run(task: CellTask) -> None:
        world = scene()
        for seed in task.seeds:
            watcher = Watcher(
                task, seed, world, grounding, draw(world, grounding, task.pixel, seed)
            )
            perceived: Perceived | None = None
            for head in heads:
                if perceived is None or grounding.joint:
                    perceived = watcher.perceive(head)
                for readout in readouts:
                    part = head if len(readouts) == 1 else f"{head}/{readout}"
                    watcher.score(perceived, head, readout, part, also)

    return run
