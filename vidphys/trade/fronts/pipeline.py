"""Clip in, rollout out: image size, how bodies are found, how momentum is read, and the step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from binders import Tracks
from dynamics import PhaseState, Rollout, rollout
from renderers import Camera, ChannelWorld, centroids
from vidphys import metrics
from vidphys.data.clips import Clips, render_clips
from vidphys.experiments.core.question import INVERSION_STEPS
from vidphys.perception.synthesis import Synthesis
from vidphys.trade.context import Context
from vidphys.trade.fronts.readouts import READOUTS
from vidphys.trade.measure import Job, Scale

SCALE = Scale(
    "pipeline",
    "ms_per_clip",
    1e3,
    "inversion_nmse",
    "true trajectories at G = -1 over 150 steps, from the true state at the last frame",
)
FRAMES, STRIDE = 5, 40  # of a clip; reference steps between frames
COMPARED = 5  # reference steps between compared states, 0.01 s
STEPS = (0.01, 0.002)  # seconds, of the rollout
FLIPPED = -1.0
# what is combined: (finder, readout, frames, step of the rollout)
CHOICES = (
    ("centroid", "differencing", 3, STEPS[0]),
    ("centroid", "shooting", 3, STEPS[0]),
    ("centroid", "shooting", 5, STEPS[0]),
    ("fit", "differencing", 3, STEPS[0]),
    ("fit", "shooting", 3, STEPS[0]),
    ("fit", "shooting", 5, STEPS[0]),
    ("fit", "shooting", 5, STEPS[1]),
)


def jobs(context: Context) -> Iterator[Job]:
    """Each choice at each image size up to 64 pixels."""
    for size in context.sizes.image_sizes:
        if size > 64:
            return
        world = ChannelWorld(Camera(height=size, width=size))
        clips = render_clips(
            context.scene, world, context.sizes.clips, FRAMES, STRIDE, context.seed, "trade-test"
        )
        case = _Case(context, clips, _truth(context, clips))
        for finder, readout, frames, dt in CHOICES:
            yield case.job(size, finder, readout, frames, dt)


def _truth(context: Context, clips: Clips) -> PhaseState:
    last = clips.states[:, -1]
    changed = clips.params.with_coupling(FLIPPED)
    return context.scene.simulate(last, changed, INVERSION_STEPS, COMPARED).states


@dataclass(frozen=True)
class _Case:
    context: Context
    clips: Clips
    truth: PhaseState

    def job(self, size: int, finder: str, readout: str, frames: int, dt: float) -> Job:
        every = round(COMPARED * self.context.scene.dt / dt)
        steps = INVERSION_STEPS // COMPARED * every
        return Job(
            task="three bodies in channels of their own, G flipped",
            configuration=dict(image=size, finder=finder, readout=readout, frames=frames, dt=dt),
            work=lambda: self.answer(finder, readout, frames, dt, steps, every),
            errors=self.errors,
            per_call=len(self.clips),
            dtype="float32",
            units={"force_evaluations": float(steps), "pixels": float(3 * frames * size * size)},
        )

    def answer(
        self, finder: str, readout: str, frames: int, dt: float, steps: int, every: int
    ) -> Rollout:
        """From bytes to the rollout under the flipped law."""
        clips, head = self.clips, self.context.head
        params = clips.params.map(torch.Tensor.float)
        tracks = FINDERS[finder](_last(clips, frames))
        state = READOUTS[readout](head, tracks, params, clips.interval)
        start = state.map(torch.Tensor.float)
        return rollout(head, start, params.with_coupling(FLIPPED), steps, dt, every)

    def errors(self, rolled: Rollout) -> dict[str, float]:
        value = metrics.nmse(rolled.states, self.truth).value
        each = metrics.episode_nmse(rolled.states, self.truth)
        return {
            "inversion_nmse": float("nan") if value is None else value,
            "inversion_nmse_median": float(each.quantile(0.5)),
        }


def _last(clips: Clips, frames: int) -> Clips:
    """The clips' last frames."""
    return replace(clips, frames=clips.frames[:, -frames:], states=clips.states[:, -frames:])


def _by_centroid(clips: Clips) -> Tracks:
    positions, light = centroids(clips.images(), clips.world.camera)
    confidence: Tensor = (light > 0).double()
    return Tracks(positions.double(), confidence, clips.times)


FINDERS: dict[str, Callable[[Clips], Tracks]] = {
    "centroid": _by_centroid,
    "fit": Synthesis().tracks,
}
