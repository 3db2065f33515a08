"""What the ladder and most pixel tables are made of: one perception, and heads on what it sees."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from dynamics import HEADS, Head, Rollout, build
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import (
    DRIFT_STEPS,
    score_drift,
    score_fixed_step,
    score_inversion,
    score_lost,
    score_start,
)
from vidphys.experiments.pixels.momentum import MomentumReadout, Shooting
from vidphys.experiments.pixels.seen import (
    Perceived,
    Seen,
    draw,
    fit_perception,
    perceive,
    pixel_scene,
    score_state,
)
from vidphys.perception.base import Grounding
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene
from vidphys.seeding import derive
from vidphys.shooting.step import HEAD_DT
from vidphys.training.tracks import TrackTask, tell_scale

TWINS = ("factored", "unstructured")  # the two heads that every rung is asked of
JOINT = "joint"  # trained together with the perception


@dataclass(frozen=True)
class Scored:
    """A head that was trained on tracks and asked.

    Args:
        readout: of momenta.
        head: trained.
        question: from the start that was read.
        rolled: the head under the law that held.
        recorder: has the numbers.
        folder: of its checkpoints, or ``None``.
    """

    readout: MomentumReadout
    head: Head
    question: Question
    rolled: Rollout
    recorder: Recorder
    folder: Path | None


@dataclass(frozen=True)
class PixelCell:
    """A cell that fits one perception for each seed and trains each head on what it sees.

    Each head is a part ``CELL/HEAD``, or ``CELL/HEAD/READOUT`` where there are several readouts.
    A training that diverged is counted, and the others go on. A head that was trained together
    with the perception is asked too, beside the fresh one: its part ends with ``joint``, and so
    does the name of its grounding.

    Args:
        grounding: how states are perceived; a joint one is fitted again for each head.
        heads: names in ``dynamics.HEADS``.
        scene: what is filmed.
        readouts: of momenta, in training and at t0.
    """

    grounding: Grounding
    heads: Sequence[str]
    scene: Callable[[], Scene] = pixel_scene
    readouts: Sequence[MomentumReadout] = (Shooting(),)

    def __call__(self, task: CellTask) -> None:
        scene, g = self.scene(), self.grounding
        for seed in task.seeds:
            drawn = partial(draw, scene, g, task.pixel, seed)
            seen = task.kept.once("seen", (g.name, seed), drawn)
            for head in self.heads:
                fitted = partial(self._perceive, task, seen, seed, head)
                key = (g.name, seed, head if g.joint else "")
                perceived = task.kept.once("perceived", key, fitted)
                each = [self._score(task, perceived, seed, head, way) for way in self.readouts]
                self.also(task, seed, head, [scored for scored in each if scored], perceived)
                if perceived.head is not None:
                    for way in self.readouts:
                        self._score_joint(task, perceived, perceived.head, seed, head, way)

    def part(self, head: str, readout: MomentumReadout) -> str | None:
        """What a head's records are called in the cell."""
        return head if len(self.readouts) == 1 else f"{head}/{readout.name}"

    def fit_folder(self, task: CellTask, seed: int, head: str) -> Path | None:
        """Where checkpoints of the perception lie."""
        return None if task.folder is None else task.folder / f"s{seed}-perception"

    def folder(self, task: CellTask, seed: int, head: str, readout: MomentumReadout) -> Path | None:
        """Where checkpoints of a head lie."""
        part = str(self.part(head, readout)).replace("/", "-")
        return None if task.folder is None else task.folder / f"s{seed}-{part}"

    def also(
        self, task: CellTask, seed: int, head: str, scored: Sequence[Scored], perceived: Perceived
    ) -> None:
        """Record or keep more of a head; ``scored`` is it under each readout that did not fail."""

    def _perceive(self, task: CellTask, seen: Seen, seed: int, head: str) -> Perceived:
        folder = self.fit_folder(task, seed, head)
        progress = task.stage("seeing")
        how = folder, progress, task.device
        fitted = fit_perception(self.grounding, seen, task.pixel, seed, head, *how)
        return perceive(fitted, seen, self.grounding.identified)

    def _recorder(
        self, task: CellTask, seen: Seen, seed: int, head: str, part: str | None, joint: str = ""
    ) -> Recorder:
        g, scene = self.grounding, seen.asked.scene
        how: dict[str, Any] = {
            "supervision": g.told(len(seen.train)),
            "knows": g.knows,
            "context": len(seen.test.times),
        }
        name = f"{g.name}{joint}"
        return task.recorder(seed, scene, head, part, name, g.encoder, g.binder, **how)

    def _score_joint(
        self,
        task: CellTask,
        perceived: Perceived,
        trained: Head,
        seed: int,
        head: str,
        readout: MomentumReadout,
    ) -> None:
        """Ask the head that was trained with the perception, from the start that it reads."""
        own = self.part(head, readout)
        part = JOINT if own is None else f"{own}/{JOINT}"
        recorder = self._recorder(task, perceived.seen, seed, head, part, f"-{JOINT}")
        reading = recorder.reading(readout.name)
        began = time.perf_counter()
        score(trained, readout, perceived, reading)
        reading.took(time.perf_counter() - began)

    def _score(
        self, task: CellTask, perceived: Perceived, seed: int, head: str, readout: MomentumReadout
    ) -> Scored | None:
        seen, scene = perceived.seen, perceived.seen.asked.scene
        recorder = self._recorder(task, seen, seed, head, self.part(head, readout))
        reading, folder = recorder.reading(readout.name), self.folder(task, seed, head, readout)
        began = time.perf_counter()
        track_task = TrackTask(
            perceived.train,
            seen.train.params,
            seen.train.interval,
            task.pixel.track_steps,
            derive(seed, "order", head, readout.name),
            save_to=folder,
            progress=task.stage(readout.name),
        )
        try:
            torch.manual_seed(derive(seed, "init", head))
            sizes = scene.bodies, HEAD_DT, scene.space, scene.conditions
            model = build(HEADS[head], *sizes).to(task.device)
            question, rolled = train_and_score(model, readout, track_task, perceived, reading)
        except FloatingPointError:
            score_lost(reading, task.pixel.held_out)
            return None
        finally:
            reading.took(time.perf_counter() - began)
        return Scored(readout, model, question, rolled, reading, folder)


def train_and_score(
    head: Head, readout: MomentumReadout, task: TrackTask, perceived: Perceived, recorder: Recorder
) -> tuple[Question, Rollout]:
    """Train an untrained head on the tracks, read the start at t0, score.

    Returns:
        What the head was asked, and its rollout under the law that held.
    """
    tell_scale(head, task)
    recorder.add_value("training_loss", readout.train(head, task).final_loss)
    return score(head, readout, perceived, recorder)


def score(
    head: Head, readout: MomentumReadout, perceived: Perceived, recorder: Recorder
) -> tuple[Question, Rollout]:
    """Read the start at t0 by a trained head and score it, as :func:`train_and_score` does.

    Its law is told from its start by two more: the true one, and differences of frames, which are
    the same for every head.
    """
    question = perceived.seen.asked.starting(readout.start(head, perceived))
    score_state(recorder, question)
    rolled = question.ask(head, DRIFT_STEPS[-1])
    score_inversion(recorder, head, question, rolled)
    score_drift(recorder, head, question, rolled=rolled)
    score_retrace(recorder, head, question)
    score_fixed_step(recorder, head, question, rolled)
    score_start(recorder, head, question, question.truth, "true_start")
    score_start(recorder, head, question, perceived.plain_start, "shared_start")
    return question, rolled
