"""What the fronts are measured on: sizes of a preset, and a head that several of them use."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import torch
from torch import Generator

from dynamics import HEADS, Head
from vidphys.experiments.core.oracle import true_segments
from vidphys.scenes import Scene, gravity
from vidphys.seeding import derive
from vidphys.training.loop import FitSettings, fit
from vidphys.training.segments import Segments, scale_of, segment_loss, standardise


@dataclass(frozen=True)
class TradeSizes:
    """How much is measured.

    Args:
        repeats: timed calls of each point.
        episodes: of a rollout.
        seconds: simulated, of a rollout.
        most_bodies: of a force.
        image_sizes: pixels of a side.
        frames: drawn or encoded at once.
        trainings: (trajectories, optimiser steps) of a head.
        clips: held-out clips of the pipeline.
        labelled: clips that position readouts learn from and are held to.
        runtimes: of encoders, beside torch's own; some take a minute to prepare.
    """

    repeats: int
    episodes: int
    seconds: float
    most_bodies: int
    image_sizes: tuple[int, ...]
    frames: int
    trainings: tuple[tuple[int, int], ...]
    clips: int
    labelled: int
    runtimes: tuple[str, ...] = ()


DTYPES = {"float64": torch.float64, "float32": torch.float32}
SIZES = {
    "quick": TradeSizes(3, 16, 0.4, 1024, (16, 64), 32, ((128, 50), (512, 50), (512, 150)), 4, 12),
    "standard": TradeSizes(
        5,
        64,
        1.0,
        16384,
        (16, 32, 64, 128, 224),
        64,
        ((128, 300), (512, 300), (2048, 300), (512, 1000), (2048, 1000)),
        12,
        48,
        ("compile", "openvino"),
    ),
}


@dataclass(frozen=True)
class Context:
    """What a front is told.

    Args:
        sizes: see :class:`TradeSizes`.
        seed: of all that is drawn.
        device: where networks run.
        weights: folder of encoders' weights; ``None`` for the usual places.
        scratch: a folder for files that are measured on.
        encoders: that are measured beside ours.
        skipped: what could not be measured, and why.
    """

    sizes: TradeSizes
    seed: int
    device: str
    weights: Path | None
    scratch: Path
    encoders: tuple[str, ...] = ()
    skipped: dict[str, str] = field(default_factory=dict)

    def skip(self, what: str, why: str) -> None:
        """Note that something could not be measured."""
        self.skipped[what] = why

    @cached_property
    def scene(self) -> Scene:
        """Softened gravity of three bodies, the study's first system."""
        return gravity()

    def rng(self, name: str) -> Generator:
        """A random stream of its own."""
        return Generator().manual_seed(derive(self.seed, "trade", name))

    @cached_property
    def head(self) -> Head:
        """A head trained with the most of the preset's trainings."""
        trajectories, steps = self.sizes.trainings[-1]
        return train_head(self.scene, trajectories, steps, self.seed)


def train_head(scene: Scene, trajectories: int, steps: int, seed: int) -> Head:
    """A ``factored-radial`` head on short true trajectories."""
    return fit_head(scene, true_segments(scene, trajectories, seed)[0], steps, seed)


def fit_head(scene: Scene, examples: Segments, steps: int, seed: int) -> Head:
    """The same on examples that are there already."""
    torch.manual_seed(derive(seed, "init"))
    head = scene.build(HEADS["factored-radial"])
    standardise(head, examples)
    batch = min(1024, len(examples))
    fit(
        head,
        segment_loss(head, scale_of(examples)),
        examples,
        FitSettings(steps, batch, 1e-2),
        seed,
    )
    return head.eval()
