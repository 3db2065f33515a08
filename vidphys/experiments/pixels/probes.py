"""Whether reading momentum needs a temporal channel, and whoever provides it.

One probe, one budget, one labelled frame a clip. A video encoder's feature frame is read from the
clip as it is, from as many copies of the labelled frame (no temporal channel), and from the clip
with all other frames in disorder. An image encoder's is read alone; then its readout is given the
channel: positions of neighbouring frames are differenced, or their features put side by side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, cast

import torch
from torch import Tensor

from dynamics import PhaseState
from encoders.features import FeatureMap
from encoders.frozen.base import FrozenEncoder
from encoders.frozen.catalogue import load_encoder
from readouts.differencing import central_difference
from readouts.probes import StateProbe, side_by_side
from renderers import Camera, RgbWorld
from vidphys.data.clips import Clips, render_clips
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.question import Question
from vidphys.experiments.pixels.foresight import BETTER, Foreseeing, foresight
from vidphys.experiments.pixels.seen import pixel_scene, score_state
from vidphys.experiments.pixels.temporal_views import VIEWS, OneFrame
from vidphys.perception.frozen import encode_clips
from vidphys.training.loop import FitSettings
from vidphys.training.probes import StateFrames, Units, train_probes

# name -> options; an encoder whose windows have more than one frame is one of video
ENCODERS: dict[str, dict[str, Any]] = {
    "i3d": {"layer": "Conv3d_2c_3x3"},
    "hiera": {},
    "videomae-tiny": {},
    "vjepa2-tiny": {},
    "dino-tiny": {},
    "vjepa2-l": {},
    "dinov2-small": {},
}
FORESEEING = "vjepa2-ac"
NO_OPS = ("zero", "resting")  # states of its arm, which does nothing in both
HELD_OUT = 8  # one clip in so many decides which weights are kept
BATCH, LEARNING_RATE, CLIP = 64, 3e-3, 1.0


@dataclass(frozen=True)
class Study:
    """One encoder's clips, and what is asked of them.

    Args:
        task: of the cell.
        name: of the encoder.
        encoder: frozen.
        train, test: clips; the label is the true state at their middle frame.
        void: a positive control failed, so that the probes prove nothing.
    """

    task: CellTask
    name: str
    encoder: FrozenEncoder
    train: Clips
    test: Clips
    void: bool = False

    @property
    def centre(self) -> int:
        """The labelled frame."""
        return (self.train.frames.shape[1] - 1) // 2

    @cached_property
    def units(self) -> Units:
        """Of the probes."""
        return Units.of(self.train.states[:, self.centre], self.half_extent)

    @property
    def half_extent(self) -> float:
        """World units."""
        return self.train.world.camera.half_extent

    def labelled_frame(self, clips: Clips, frames: Tensor) -> FeatureMap:
        """Its features ``(b, 1, c, h, w)``, where it stands among such frames."""
        one = OneFrame(self.encoder, self.centre)
        return encode_clips(one, replace(clips, frames=frames), self.task.folder)

    def neighbours(self, clips: Clips) -> FeatureMap:
        """Features of the labelled frame and the two beside it, ``(b, 3, c, h, w)``."""
        frames = clips.frames[:, self.centre - 1 : self.centre + 2]
        return encode_clips(self.encoder, replace(clips, frames=frames), self.task.folder)

    def probes(self, features: FeatureMap, values: Tensor, part: str) -> list[StateProbe]:
        """A probe for each seed over feature frames ``(b, c, h, w)`` of the training clips."""
        states = self.train.states[:, self.centre]
        return self.fit(self.units.frames(values, features.cell_centres(), states), part)

    def fit(self, frames: StateFrames, part: str) -> list[StateProbe]:
        """A probe for each seed; the last clips decide which weights are kept."""
        index = torch.arange(len(frames))
        kept = max(1, len(frames) // HELD_OUT)
        settings = FitSettings(self.task.pixel.perception_steps, BATCH, LEARNING_RATE, CLIP)
        name = f"{self.name}-{part}"
        return train_probes(
            frames[index[:-kept]],
            frames[index[-kept:]],
            self.task.seeds,
            settings,
            name,
            self.task.checkpoint(f"probes-{part}"),
            self.task.progress,
            self.task.device,
        )

    def score(self, part: str, states: list[PhaseState]) -> None:
        """Errors of the test clips' states, one for each seed."""
        truth = self.test.states[:, self.centre]
        for seed, state in zip(self.task.seeds, states, strict=True):
            scene = pixel_scene()
            recorder = self.task.recorder(seed, scene, "none", part, self.name, self.name)
            score_state(recorder.reading("probe"), Question(scene, state, truth, self.test.params))
            if self.void:
                recorder.void()


def encoder_cell(name: str, options: Mapping[str, Any]) -> Cell:
    """A cell that encodes one encoder's clips once, and trains all seeds' probes over them."""

    def run(task: CellTask) -> None:
        encoder = cast(FrozenEncoder, load_encoder(name, dict(options), device=task.device))
        study = Study(task, name, encoder, *draw_clips(task))
        (study_video if encoder.windowing.frames > 1 else study_images)(study)

    return run


def foreseeing_cell(task: CellTask) -> None:
    """The probes of V-JEPA 2-AC's predictor, void where a copy of the last frame is as good.

    Its arm does nothing, in two states.
    """
    clips = draw_clips(task)
    for state in NO_OPS:
        options = {"state": state}
        encoder = cast(FrozenEncoder, load_encoder(FORESEEING, options, device=task.device))
        found = foresight(cast(Foreseeing, encoder), clips[1].frames.to(task.device))
        name = f"{FORESEEING}-{state}"
        for seed in task.seeds:  # which see the same clips
            recorder = task.recorder(seed, pixel_scene(), "none", state, name, FORESEEING)
            recorder.add_value("foresight_over_copy", found.over_copy)
            recorder.add_value("frame_step", found.step)
        study_video(Study(task, name, encoder, *clips, void=not found.foresees), f"{state}-")


def draw_clips(task: CellTask) -> tuple[Clips, Clips]:
    """Training and test clips of coloured disks, of the preset's sizes.

    They are of the first seed, and all seeds' probes see them, so that features are made once.
    """
    sizes = task.pixel
    world = RgbWorld(camera=Camera(height=sizes.image, width=sizes.image))
    draw = partial(render_clips, pixel_scene(), world)
    return (
        draw(sizes.clips, sizes.frames, sizes.stride, task.seeds[0], "train"),
        draw(2 * sizes.held_out, sizes.frames, sizes.stride, task.seeds[0], "test"),
    )


def study_video(study: Study, prefix: str = "") -> None:
    """The three temporal configurations of a video encoder; ``prefix`` begins their names."""
    for name, view in VIEWS.items():
        part = prefix + name
        train, test = (
            study.labelled_frame(clips, view(clips.frames, study.centre))
            for clips in (study.train, study.test)
        )
        probes = study.probes(train, train.values[:, 0], part)
        read = partial(study.units.read, values=test.values[:, 0], centres=test.cell_centres())
        study.score(part, [read(probe) for probe in probes])


def study_images(study: Study) -> None:
    """One frame; positions of neighbours differenced; a window, told momenta or differences."""
    train, test = (study.neighbours(clips) for clips in (study.train, study.test))
    single = study.probes(train, train.values[:, 1], "single")
    centres = test.cell_centres()
    study.score("single", [study.units.read(p, test.values[:, 1], centres) for p in single])
    study.score("differenced", [_differenced(study, p, test, study.test) for p in single])
    taught = [_differenced(study, probe, train, study.train) for probe in single]
    windows = side_by_side(train.values)
    labels = {
        "window": study.train.states[:, study.centre],
        "window-taught-by-differences": _mean(taught),
    }
    for part, states in labels.items():
        probes = study.fit(study.units.frames(windows, train.cell_centres(), states), part)
        seen = side_by_side(test.values)
        study.score(part, [study.units.read(probe, seen, centres) for probe in probes])


def _differenced(study: Study, probe: StateProbe, features: FeatureMap, clips: Clips) -> PhaseState:
    """The middle frame's state from one-frame positions of three frames."""
    values, centres = features.values, features.cell_centres()
    positions = [study.units.read(probe, values[:, t], centres).q for t in range(3)]
    mass = clips.params.mass
    return central_difference(torch.stack(positions, 1), mass, clips.interval)[:, 0]


def _mean(states: list[PhaseState]) -> PhaseState:
    return PhaseState(
        torch.stack([s.q for s in states]).mean(0), torch.stack([s.p for s in states]).mean(0)
    )


PROBES = Table.told(
    "probes",
    cells={
        **{name: encoder_cell(name, options) for name, options in ENCODERS.items()},
        FORESEEING: foreseeing_cell,
    },
    settings={
        "scene": pixel_scene().settings,
        "encoders": {**ENCODERS, FORESEEING: {"state": NO_OPS}},
        "foresees_below": BETTER,
        "batch": BATCH,
        "learning_rate": LEARNING_RATE,
    },
)
