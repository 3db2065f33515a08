"""Supervised perception of ever faster bodies: positions hold, momenta are what suffers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import torch
from torch import Generator

from dynamics import Parameters, PhaseState
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.core.question import Question
from vidphys.experiments.pixels.momentum import MOMENTUM
from vidphys.experiments.pixels.pixel_cell import PixelCell, Scored
from vidphys.experiments.pixels.seen import Perceived, pixel_scene
from vidphys.perception.catalogue import RUNGS
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene

SPEEDS = (0.5, 1.0, 2.0, 4.0)  # over the headline generator's


def faster(scene: Scene, factor: float) -> Scene:
    """The scene with all starting momenta times ``factor``."""

    def sample(episodes: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        start, params = scene.sample(episodes, rng)
        return PhaseState(start.q, factor * start.p), params

    return replace(scene, sample=sample, settings={**scene.settings, "speed": factor})


def score_rmse(recorder: Recorder, question: Question) -> None:
    """Errors of the perceived start in world units, which no spread divides."""
    for name, seen, true in (
        ("position_rmse", question.start.q, question.truth.q),
        ("momentum_rmse", question.start.p, question.truth.p),
    ):
        error = seen.double() - true
        recorder.add_value(name, float(error.square().mean().sqrt()))
    speed = torch.linalg.vector_norm(question.truth.p, dim=-1)
    recorder.add_value("mean_speed", float(speed.mean()))


class SpeedCell(PixelCell):
    """A pixel cell that records errors of the start in world units too."""

    def also(
        self, task: CellTask, seed: int, head: str, scored: Sequence[Scored], perceived: Perceived
    ) -> None:
        for one in scored:
            score_rmse(one.recorder, one.question)


PERCEPTION_SPEED = Table.told(
    "perception-speed",
    cells={
        f"speed-{factor:g}": SpeedCell(
            RUNGS["cnn-supervised"],
            ("factored",),
            partial(faster, pixel_scene(), factor),
            tuple(MOMENTUM.values()),
        )
        for factor in SPEEDS
    },
    settings={"scene": pixel_scene().settings, "speeds": SPEEDS},
)
