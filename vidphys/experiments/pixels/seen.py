"""The rungs with pictures: clips are rendered and perceived, and the perceived start is scored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from binders import Tracks
from dynamics import Head, PhaseState
from readouts.differencing import backward_difference
from renderers import WORLDS, Camera
from vidphys import metrics
from vidphys.data.clips import Clips, render_clips
from vidphys.experiments.core.question import Question
from vidphys.perception.base import (
    Attentive,
    FitTask,
    Foreseeing,
    Grounding,
    Looking,
    Perception,
)
from vidphys.perception.relabel import relabel
from vidphys.presets import PixelSizes
from vidphys.progress import Progress
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene, gravity
from vidphys.seeding import derive


def pixel_scene() -> Scene:
    """Three bodies under gravity, of unit masses: a disk's picture does not show its mass."""
    return gravity("gaussian", mass=(1.0, 1.0))


@dataclass(frozen=True)
class Seen:
    """Training and held-out clips of a rung; the held-out ones end at t0.

    ``asked`` is the question about them, from the true start; all readouts and heads share it.
    """

    train: Clips
    test: Clips
    asked: Question


def draw(scene: Scene, grounding: Grounding, sizes: PixelSizes, seed: int) -> Seen:
    """Render the clips of a rung; the held-out motions, and their t0, are those of every rung."""
    camera = Camera(scene.half_extent, sizes.image, sizes.image)
    world = WORLDS[grounding.world](camera=camera)
    clips = max(2, sizes.clips // grounding.share)
    train = render_clips(scene, world, clips, sizes.frames, sizes.stride, seed, "train")
    test = render_clips(scene, world, sizes.held_out, sizes.frames, sizes.stride, seed, "test")
    start = test.states[:, -1]
    return Seen(train, test, Question(scene, start, start, test.params))


@dataclass(frozen=True)
class Perceived:
    """Tracks of both sets of ``seen`` clips.

    Args:
        seen: the clips.
        perception: fitted.
        train, test: tracks; the held-out ones are relabelled to the true bodies where these look
            alike.
        under: follows the held-out clips anew with a trained head, which foresees where bodies
            that look alike go; a perception that knows who is who has nothing to gain by it.
        head: that was trained together with the perception, or ``None``.
    """

    seen: Seen
    perception: Perception
    train: Tracks
    test: Tracks
    under: Callable[[Head], Tracks]
    head: Head | None = None

    @cached_property
    def attention(self) -> Tensor | None:
        """What is attended to in the first held-out clip, where the perception can tell."""
        if not isinstance(self.perception, Looking):
            return None
        return self.perception.attention(self.seen.test.first(1))

    @property
    def plain_start(self) -> PhaseState:
        """States at t0 by differences of frames, the same whatever the head."""
        clips = self.seen.test
        return backward_difference(
            self.test.positions, clips.params.mass.to(self.test.positions), clips.interval
        )


def perceive(perception: Perception, seen: Seen, identified: bool = False) -> Perceived:
    """Run a fitted perception over the clips of a rung.

    Args:
        perception: fitted.
        seen: the clips.
        identified: whether pictures say who is who; else each clip's tracks are given the numbers
            of the true bodies.
    """
    truth = seen.test.states.q
    look = perception.closely if isinstance(perception, Attentive) else perception.tracks

    def named(tracks: Tracks) -> Tracks:
        return tracks if identified else relabel(tracks, truth)

    test = named(look(seen.test))

    def under(head: Head) -> Tracks:
        if not isinstance(perception, Foreseeing):
            return test
        return named(perception.under(head).tracks(seen.test))

    head: Head | None = getattr(perception, "head", None)
    return Perceived(seen, perception, perception.tracks(seen.train), test, under, head)


def fit_perception(
    grounding: Grounding,
    seen: Seen,
    sizes: PixelSizes,
    seed: int,
    head: str,
    folder: Path | None,
    progress: Progress | None,
    device: str = "cpu",
) -> Perception:
    """Fit a rung's perception; a joint one through a head of the given name."""
    task_seed = derive(seed, "perception", grounding.of or grounding.name)
    torch.manual_seed(task_seed)
    return grounding.fit(FitTask(seen.train, sizes, task_seed, head, folder, progress, device))


def score_state(recorder: Recorder, question: Question) -> None:
    """Errors of the perceived state at t0, position and momentum apart, and the affine residual."""
    start, truth = question.start, question.truth
    pairs = {"position_nmse": (start.q, truth.q), "momentum_nmse": (start.p, truth.p)}
    for name, (seen, true) in pairs.items():
        error = (seen.double() - true).square().flatten(1).mean(1)
        relative = error / true.var(correction=0)
        lost = int((~torch.isfinite(relative)).sum())
        value = None if lost else float(relative.mean())
        status = metrics.FAILED if lost else metrics.OK
        recorder.add(name, metrics.Summary(value, status, len(error), lost))
        recorder.add_episodes(name, relative)
    recorder.add("affine_residual", metrics.affine_residual(start.flat, truth.flat))
