"""Supervised perception of ever faster bodies: positions hold, momenta are what suffers (N52)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import torch
from torch import Generator

from dynamics import Parameters, PhaseState
from vidphys.experiments.core.cell import Table
from vidphys.experiments.core.scoring import Question
from vidphys.experiments.ladder import pixel_scene
from vidphys.experiments.pixels.seeing import seen_cell
from vidphys.experiments.pixels.seen import TRAINERS
from vidphys.perception.catalogue import GROUNDINGS
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


PERCEPTION_SPEED = Table(
    name="perception-speed",
    title="Supervised perception and the speed of the bodies",
    about=(
        "A CNN told true positions sees ever faster bodies. Momentum is read by differencing "
        "frames, as in the study, and by shooting through the head; both start the flip."
    ),
    ids="N52",
    cells={
        f"speed-{factor:g}": seen_cell(
            GROUNDINGS["cnn-supervised"],
            ("factored",),
            partial(faster, pixel_scene(), factor),
            tuple(TRAINERS),
            score_rmse,
        )
        for factor in SPEEDS
    },
    settings={"scene": pixel_scene().settings, "speeds": SPEEDS},
    pixels=True,
)
