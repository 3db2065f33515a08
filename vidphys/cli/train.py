"""``vidphys train``: a readout over a frozen encoder, and the dynamics of what it sees."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.extract import ExtractConfig, frozen_encoder
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.experiments.clip_dynamics import Forecast
    from vidphys.experiments.real_clip import PerceivedClip
    from vidphys.records import Recorder
    from vidphys.runs import RunFolder

STAGES = 4


@dataclass(frozen=True)
class TrainConfig:
    """Train a readout and a dynamics head on a clip, and roll past its end.

    Example: vidphys train clip.mp4 --store features --out runs/clip --weights weights

    Args:
        clip: the video file; one body moves before a still camera.
        store: folder of the feature store; what is missing in it is extracted.
        out: the run folder.
        weights: file or folder of the encoder's weights; else VIDPHYS_WEIGHTS.
        layer: the stage that is read, by its stride in network pixels.
        resolution: network pixels of the longer image side, a multiple of 32.
        steps: optimiser steps of each readout.
        start: first frame of the clip that is used (a hand may hold the body before it).
        stop: frame to stop before.
        train_share: part of the clip, from its start, that is trained on.
        beyond: seconds to roll past the end of the clip.
        seed: of initial weights and batch order.
        device: where the encoder runs.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    clip: Annotated[Path, tyro.conf.Positional]
    store: Path = Path("features")
    out: Path = Path("runs/clip")
    weights: Path | None = None
    layer: Literal[4, 8, 16, 32] = 8
    resolution: int = 128
    steps: int = 1200
    start: int = 0
    stop: int | None = None
    train_share: float = 0.6
    beyond: float = 3.0
    seed: int = 0
    device: Literal["cpu", "cuda"] = "cpu"
    overwrite: bool = False
    quiet: bool = False


def train(config: TrainConfig) -> None:
    """See :class:`TrainConfig`.

    Raises:
        InputError: a clip that is missing, too short or without a moving body; weights that are
            missing or wrong; a device that is not there; another run in the folder.
    """
    from encoders.store import FeatureStore
    from vidphys.experiments.clip_dynamics import HEADS, forecast
    from vidphys.experiments.real_clip import RealClipSettings, perceive_clip
    from vidphys.runs import RunFolder
    from vidphys.train import FitSettings
    from vidphys.video import ClipSelection, read_video

    if not config.clip.is_file():
        raise InputError(f"train: {config.clip}: no such file; nothing was trained")
    video = read_video(config.clip, ClipSelection(config.start, config.stop))
    try:
        encoder = frozen_encoder(_extraction(config))
    except ValueError as error:
        raise InputError(str(error)) from error
    fit = FitSettings(config.steps, 16, 3e-3)
    settings = RealClipSettings(train_share=config.train_share, fit=fit, seed=config.seed)
    run = RunFolder.open(config.out, _settings(config), config.overwrite)
    with run.locked(), Console(config.quiet, STAGES, "train") as console:

        def show(step: int, steps: int, _loss: float) -> None:
            console.stage(("train", step, steps))

        try:
            seen = perceive_clip(video, encoder, FeatureStore(config.store), settings, show)
        except ValueError as error:
            run.abandon()
            raise InputError(str(error)) from error
        console.done(0)
        forecasts = {
            name: forecast(
                name, seen.steady_track, seen.split.end, config.beyond, config.seed, show
            )
            for name in HEADS
        }
        console.done(1)
        recorder = _record(config, seen, forecasts)
        run.finish(f"clip-s{config.seed}", *recorder.tables())
        run.join()
        _keep(run, seen, forecasts)
        console.done(2)
        _draw(run, seen, forecasts["damped"])
        console.done(3)
        for row in recorder.rows:
            console.result(f"{row['head']:<18}{row['metric']:<34}{row['value']:.4g}")
        console.result(f"recording: {run.path / 'recordings' / 'clip.rrd'}")


def _extraction(config: TrainConfig) -> ExtractConfig:
    return ExtractConfig(
        clips=(config.clip,),
        out=config.store,
        weights=config.weights,
        layer=config.layer,
        resolution=config.resolution,
        device=config.device,
    )


def _settings(config: TrainConfig) -> dict[str, Any]:
    from vidphys.atomic import sha256

    plain = {k: str(v) if isinstance(v, Path) else v for k, v in asdict(config).items()}
    for key in ("out", "overwrite", "quiet", "store", "weights"):
        plain.pop(key)
    return {
        "experiment": "train",
        "cells": ["clip/damped", "clip/unstructured"],
        "seeds": [config.seed],
        "clip_sha256": sha256(config.clip),
        **plain,
    }


def _record(config: TrainConfig, seen: PerceivedClip, forecasts: dict[str, Forecast]) -> Recorder:
    """Readout errors and forecast errors on the frames that no training saw."""
    from dataclasses import replace

    from vidphys.experiments.clip_dynamics import forecast_error, naive_forecasts
    from vidphys.records import Origin, Recorder

    origin = Origin(
        "train",
        "clip",
        config.clip.name,
        "hiera",
        "hiera",
        "motion",
        "attention",
        "none",
        config.seed,
        config.device,
        "float32",
    )
    recorder = Recorder(origin)
    for score in seen.scores:
        recorder.origin = replace(origin, readout=score.name, head=score.name)
        recorder.add_value("readout_rmse_normalised", score.normalised)
        recorder.add_value("readout_rmse_pixels", score.pixels)
    # The forecast is judged by the hand binder, seen as by a camera that does not drift.
    moved = seen.hand.tracks.positions - seen.hand.camera[None, :, None]
    judge = replace(seen.hand.tracks, positions=moved)
    paths = {name: (f.times, f.positions) for name, f in forecasts.items()}
    for name, (times, positions) in {
        **paths,
        **naive_forecasts(seen.steady_track, seen.split.end),
    }.items():
        recorder.origin = replace(origin, cell=f"clip/{name}", head=name)
        error = forecast_error(times, positions, judge, seen.split.scored)
        recorder.add_value("forecast_rmse_normalised", error)
        friction = forecasts[name].friction if name in forecasts else None
        if friction is not None:
            recorder.add_value("friction_per_second", friction)
    return recorder


def _keep(run: RunFolder, seen: PerceivedClip, forecasts: dict[str, Forecast]) -> None:
    """Checkpoints of the readouts and the heads."""
    from dynamics.terms import to_config
    from vidphys import checkpoint
    from vidphys.experiments.clip_dynamics import HEADS

    for name, trained in seen.readouts.items():
        path = run.checkpoints("readouts") / f"{name}.json"
        checkpoint.save(path, dict(trained.module.state_dict()), {"step": 0, "readout": name})
    for name, found in forecasts.items():
        path = run.checkpoints("heads") / f"{name}.json"
        meta = {"step": 0, "terms": to_config(HEADS[name]), "bodies": 1, "space": 1}
        checkpoint.save(path, dict(found.head.state_dict()), meta)


def _draw(run: RunFolder, seen: PerceivedClip, found: Forecast) -> None:
    """The clip with what was followed, read and foretold drawn over it."""
    import numpy as np

    from viz.recording import write_overlay_recording

    stamps = seen.video.times
    drift = seen.hand.camera.numpy()
    camera = np.stack(
        [np.interp(found.times.numpy(), stamps, drift[:, axis]) for axis in range(2)], -1
    )
    arrays = {
        "frames": seen.video.frames,
        "frame_times": stamps,
        "track": seen.hand.tracks.positions[0].numpy(),
        "readout": seen.track.positions[0].numpy(),
        "rollout": found.positions.numpy() + camera[:, None],
        "rollout_times": found.times.numpy(),
        "half_extent": np.asarray(1.0),
        "train_end": np.asarray(stamps[seen.split.end - 1]),
    }
    meta = {"cell": "clip", "clip": seen.video.path.name}
    write_overlay_recording(arrays, meta, run.path / "recordings" / "clip.rrd")
