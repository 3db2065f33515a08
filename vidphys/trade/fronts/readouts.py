"""Momentum from positions: how many frames, differenced or fitted through the dynamics."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from binders import Tracks
from dynamics import PhaseState
from renderers import Camera, ChannelWorld
from vidphys.data.clips import Clips, render_clips
from vidphys.perception.synthesis import Synthesis
from vidphys.shooting.initial_state import by_differencing, by_shooting
from vidphys.trade.context import Context
from vidphys.trade.measure import Job, Scale

SCALE = Scale(
    "readouts",
    "ms_per_reading",
    1e3,
    "momentum_nmse",
    "true momenta at the last frame; squared error over their variance",
)
READOUTS = {"differencing": by_differencing, "shooting": by_shooting}
CONTEXTS = {"differencing": (3,), "shooting": (3, 4, 5)}  # frames; differencing reads the last 3
LONGEST = 5
IMAGE, STRIDE = 64, 40  # pixels, reference steps between frames


def jobs(context: Context) -> Iterator[Job]:
    """Each way to read momentum from tracks that were fitted to frames, at each length."""
    world = ChannelWorld(Camera(height=IMAGE, width=IMAGE))
    count = context.sizes.clips
    clips = render_clips(
        context.scene, world, count, LONGEST, STRIDE, context.seed, "trade-readouts"
    )
    tracks = Synthesis().tracks(clips)
    for readout, contexts in CONTEXTS.items():
        for frames in contexts:
            yield _job(context, clips, tracks, readout, frames)


def _job(context: Context, clips: Clips, tracks: Tracks, readout: str, frames: int) -> Job:
    last = Tracks(
        tracks.positions[:, -frames:], tracks.confidence[:, -frames:], tracks.times[-frames:]
    )
    params = clips.params.map(torch.Tensor.float)
    head, truth = context.head, clips.states.p[:, -1]

    def errors(state: PhaseState) -> dict[str, float]:
        missed = (state.p.double() - truth).square()
        return {
            "momentum_nmse": float(missed.mean() / truth.var(correction=0)),
            "momentum_nmse_median": float(
                missed.mean((-2, -1)).quantile(0.5) / truth.var(correction=0)
            ),
        }

    return Job(
        task=f"momenta of {context.scene.bodies} bodies from {IMAGE}-pixel frames",
        configuration={"readout": readout, "frames": frames},
        work=lambda: READOUTS[readout](head, last, params, clips.interval),
        errors=errors,
        per_call=len(clips),
        dtype="float32",
        units={"frames": float(frames)},
    )
