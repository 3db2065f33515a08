"""Which clips does a training find unlike its own, and which of its own kind by mistake?

A readout and dynamics are trained as ``vidphys train`` does. New clips of the same kind, and some
that are changed in one way each, are then held against what the training saw; see
:mod:`vidphys.reading.familiar`. A flag is worth what it raises beyond what it raises by mistake.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Generator, Tensor

from binders import BINDERS
from dynamics import Parameters, PhaseState
from encoders.store import FeatureStore
from readouts.kinds import READOUTS
from renderers import Camera, RgbWorld
from vidphys import metrics
from vidphys.data.clips import Clips, pictures, render_clips
from vidphys.data.dataset import find_dataset
from vidphys.data.frames import held
from vidphys.data.rendered import RenderSettings, render_folder
from vidphys.data.video import ClipSelection
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.pixels.seen import pixel_scene
from vidphys.progress import Progress
from vidphys.reading.familiar import SAID, Flag
from vidphys.reading.pipeline import Pipeline
from vidphys.reading.reader import LoadedEncoder, load_layers
from vidphys.reading.seen_clips import see
from vidphys.reading.training import TrainSettings, perceive, understand
from vidphys.runs.folder import RunFolder
from vidphys.scenes.scene import Sampler
from vidphys.seeding import derive
from vidphys.training.candidates import Grid
from vidphys.training.early_stopping import StopSettings
from vidphys.training.learner import FitSettings
from vidphys.training.readouts import ReadoutSettings

ENCODERS = ("dino-tiny", "vjepa2-tiny", "hiera")
FRAMES = 24  # of a clip
PER_CLIP = 8  # clips of the preset to one of these, which are longer
HELD_AGAINST = 2  # episodes of the preset to one new clip of each kind
READOUT, BATCH, LEARNING_RATE = "attention", 16, 3e-3
SAME, ANY = "same", "any"
NOISE, DIM, BLUR = 25, 0.5, 5  # of 255; share of the light; pixels of a box


@dataclass(frozen=True)
class Change:
    """How clips of another kind are made from lawful ones.

    Args:
        seen: what their frames ``(b, t, c, H, W)``, bytes, become.
        coupling: over the one that they are told to have.
        hurry: frames of the simulation to one that is shown at the usual rate.
        body: whether one that the training never saw lies among them.
    """

    seen: Callable[[Tensor, Generator], Tensor] | None = None
    coupling: float = 1.0
    hurry: int = 1
    body: bool = False


def _noisy(frames: Tensor, rng: Generator) -> Tensor:
    return (frames + NOISE * torch.randn(frames.shape, generator=rng)).clamp(0, 255).byte()


def _dim(frames: Tensor, rng: Generator) -> Tensor:
    return (DIM * frames).byte()


def _blurred(frames: Tensor, rng: Generator) -> Tensor:
    flat = frames.flatten(0, 1).float()
    return torch.nn.functional.avg_pool2d(flat, BLUR, 1, BLUR // 2).byte().view_as(frames)


def _lit(frames: Tensor, rng: Generator) -> Tensor:
    """As by a lamp at one side."""
    light = torch.linspace(0, 80, frames.shape[-1])
    return (frames + light).clamp(0, 255).byte()


def _disordered(frames: Tensor, rng: Generator) -> Tensor:
    return frames[:, torch.randperm(frames.shape[1], generator=rng)]


CHANGES = {
    SAME: Change(),
    "noisy": Change(_noisy),
    "dim": Change(_dim),
    "blurred": Change(_blurred),
    "lit": Change(_lit),
    "another-body": Change(body=True),
    "repelled": Change(coupling=-1.0),
    "hurried": Change(hurry=3),
    "disordered": Change(_disordered),
}


def flag_cell(name: str, task: CellTask) -> None:
    """Train over one encoder, and ask of clips of every kind."""
    encoders = load_layers(name, {}, (None,), device=task.device)
    for seed in task.seeds:
        with tempfile.TemporaryDirectory() as folder:
            pipeline = trained(Path(folder), encoders, task, seed)
        flags = {kind: flags_of(pipeline, task, seed, kind) for kind in CHANGES}
        for kind, found in flags.items():
            recorder = task.recorder(seed, pixel_scene(), "factored", kind, name, name)
            for flag in SAID:
                values, usual = (_values(some, flag) for some in (found, flags[SAME]))
                recorder.add(f"auroc_{flag}", metrics.auroc(values, usual))
                raised = [any(f.raised for f in own if f.name == flag) for own in found]
                recorder.add(f"raised_{flag}", metrics.mean(torch.tensor(raised).double()))
                recorder.add_episodes(flag, values)
            raised = [any(flag.raised for flag in own) for own in found]
            recorder.add(f"raised_{ANY}", metrics.mean(torch.tensor(raised).double()))


def trained(
    folder: Path, encoders: dict[int | str | None, LoadedEncoder], task: CellTask, seed: int
) -> Pipeline:
    """What ``vidphys train`` makes of rendered clips."""
    sizes = task.pixel
    looks = RenderSettings(
        "gravity", "rgb", sizes.clips // PER_CLIP, FRAMES, sizes.stride, sizes.image, seed
    )
    with RunFolder.at_work(folder / "clips", {"cells": [], "seeds": [seed]}) as run:
        render_folder(run, looks)
    fit = FitSettings(task.pixel.perception_steps, BATCH, LEARNING_RATE, READOUTS[READOUT].clip)
    settings = TrainSettings(
        ReadoutSettings(fit, READOUTS[READOUT].shift or 0, StopSettings()),
        Grid(READOUT, {}, (LEARNING_RATE,), (seed,)),
        mirrors=False,
        head_steps=sizes.track_steps,
        seed=seed,
        device=task.device,
    )

    def stage(name: str) -> Progress:
        return task.stage(name) or (lambda *_: None)

    dataset, store = find_dataset(folder / "clips"), FeatureStore(folder / "features")
    clips = see(dataset, encoders, store, ClipSelection(), BINDERS["motion"](), stage)
    perceived = perceive(clips, dataset, encoders, store, settings, None, stage)
    return understand(perceived, False, settings, None, stage)


def flags_of(pipeline: Pipeline, task: CellTask, seed: int, kind: str) -> list[list[Flag]]:
    """Of each new clip of a kind; all kinds are of the same episodes."""
    rng = Generator().manual_seed(derive(seed, "unfamiliar", kind))
    clips = changed(task, seed, kind, rng)
    found = []
    for k in range(len(clips)):
        shown = held(np.ascontiguousarray(clips.frames[k].permute(0, 2, 3, 1).numpy()))
        law, once = clips.params[[k]], clips.interval
        reading = pipeline(shown, clips.times.numpy(), law, beyond=once)
        found.append(list(reading.flags))
    return found


def changed(task: CellTask, seed: int, kind: str, rng: Generator) -> Clips:
    """New clips of a kind, told to follow the usual law at the usual rate."""
    change, sizes, scene = CHANGES[kind], task.pixel, pixel_scene()
    scene = replace(scene, sample=partial(_under, scene.sample, change.coupling))
    world = RgbWorld(Camera(height=sizes.image, width=sizes.image))
    count, stride = sizes.held_out // HELD_AGAINST, change.hurry * sizes.stride
    clips = render_clips(scene, world, count, FRAMES, stride, seed, "unfamiliar")
    frames = clips.frames
    if change.body:
        q = clips.states.q
        other = torch.randn(len(q), 1, 1, 2, generator=rng).to(q).expand(-1, FRAMES, -1, -1)
        frames = pictures(world, torch.cat([q, other], -2))
    if change.seen is not None:
        frames = change.seen(frames, rng)
    params = clips.params.with_coupling(clips.params.coupling / change.coupling)
    return replace(clips, frames=frames, params=params, interval=sizes.stride * scene.dt)


def _under(
    usual: Sampler, coupling: float, episodes: int, rng: Generator
) -> tuple[PhaseState, Parameters]:
    """The usual starts under so many times the coupling."""
    start, params = usual(episodes, rng)
    return start, params.with_coupling(coupling * params.coupling)


def _values(flags: list[list[Flag]], name: str) -> Tensor:
    """Of each clip; NaN where it has none."""
    own = [[flag.value for flag in some if flag.name == name] for some in flags]
    return torch.tensor([some[0] if some else torch.nan for some in own], dtype=torch.float64)


UNFAMILIAR = Table.told(
    "unfamiliar",
    cells={name: partial(flag_cell, name) for name in ENCODERS},
    settings={
        "scene": pixel_scene().settings,
        "kinds": sorted(CHANGES),
        "frames": FRAMES,
        "readout": READOUT,
    },
)
