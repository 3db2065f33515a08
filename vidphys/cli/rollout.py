"""``vidphys rollout``: a trained pipeline reads a clip and rolls it on, also under another law."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.profiles import with_profile
from vidphys.devices import check_cuda
from vidphys.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from vidphys.reading.forecasts import Forecast
    from vidphys.reading.pipeline import Reading
    from vidphys.runs.folder import RunFolder


@dataclass(frozen=True)
class RolloutConfig:
    """Read a clip with a trained pipeline and roll on from its last frame.

    Example: vidphys rollout runs/clip clip.mp4 --beyond 5 --coupling -1 --out runs/flipped

    Writes rollout.npz (positions as a camera without drift sees them, in the units of the
    training's labels) and a recording for `vidphys view`.

    Args:
        run: folder of a finished `vidphys train`.
        clip: the video; the coupling and masses of a rendered one are known.
        out: the folder that is written.
        beyond: seconds to roll past the last frame.
        coupling: also roll under this coupling in place of the one that held.
        no_friction: also roll without the friction that was learned.
        head: the model that rolls: factored, its twin unstructured, or another of the training.
        start: first frame that is read.
        stop: frame to stop before, from which it is rolled on.
        rate: frames per second, in place of the container's time stamps.
        weights: file or folder of the encoder's weights; else VIDPHYS_WEIGHTS.
        profile: take what it sets of this verb from a point that `vidphys trade --pick` chose.
        device: where the encoder runs.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    run: Annotated[Path, tyro.conf.Positional]
    clip: Annotated[Path, tyro.conf.Positional]
    out: Path = Path("runs/rollout")
    beyond: float = 3.0
    coupling: float | None = None
    no_friction: bool = False
    head: str = "factored"
    start: int = 0
    stop: int | None = None
    rate: float | None = None
    weights: Path | None = None
    profile: Path | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    overwrite: bool = False
    quiet: bool = False


def rollout(config: RolloutConfig) -> None:
    """See :class:`RolloutConfig`.

    Raises:
        InputError: no pipeline, other weights, a clip that cannot be read or is too short, a head
            that cannot do what is asked, or another run in the folder.
    """
    config = with_profile(config, "rollout")
    from vidphys.cli.recordings import record_rollout
    from vidphys.data.dataset import clip_file
    from vidphys.data.video import ClipSelection, read_video, require_frames
    from vidphys.reading.pipeline import load_pipeline
    from vidphys.runs.folder import RunFolder

    if not config.beyond > 0:
        raise InputError(f"--beyond {config.beyond}: must be above 0 seconds")
    check_cuda(config.device)
    file = clip_file(config.clip)
    try:
        pipeline = load_pipeline(config.run, config.weights, config.device)
    except ValueError as error:
        raise InputError(str(error)) from error
    how = pipeline.reader.stride, pipeline.reader.side, config.rate
    video = read_video(config.clip, ClipSelection(config.start, config.stop, *how))
    require_frames(video)
    law = file.law(pipeline.reader.bodies)
    run = RunFolder.open(config.out, _about(config, video.sha256), config.overwrite)
    with run.locked(), Console(config.quiet, 1, "rollout") as console:
        try:
            reading = pipeline(video.frames, video.times, law, config.beyond, config.head)
            changed = None
            if config.coupling is not None or config.no_friction:
                other = law if config.coupling is None else law.with_coupling(config.coupling)
                began = float(video.times[-1])
                changed = pipeline.roll(
                    reading.state, began, other, config.beyond, config.head, not config.no_friction
                )
        except ValueError as error:
            run.abandon()
            raise InputError(f"{config.clip}: {error}") from error
        _write(run.path / "rollout.npz", reading, changed)
        record_rollout(run.path, video, reading, changed, pipeline.reader.half_extent)
        console.done(0)
        _show(run, reading, changed, console)


def _about(config: RolloutConfig, sha256: str) -> dict[str, Any]:
    from vidphys.reading.pipeline import FILE
    from vidphys.runs.atomic import sha256 as hash_of

    kept = ("beyond", "coupling", "no_friction", "head", "start", "stop", "rate")
    return {
        "experiment": "rollout",
        "cells": ["rollout"],
        "seeds": [],
        "pipeline_sha256": hash_of(config.run / "checkpoints" / FILE),
        "clip_sha256": sha256,
        **{name: getattr(config, name) for name in kept},
    }


def _write(path: Path, reading: Reading, changed: Forecast | None) -> None:
    import numpy as np

    from vidphys.runs.atomic import write_with

    arrays: dict[str, np.ndarray] = {
        "times": reading.tracks.times.numpy(),
        "track": reading.tracks.positions[0].numpy(),
        "confidence": reading.tracks.confidence[0].numpy(),
        "camera": reading.camera.numpy(),
        "rollout_times": reading.rollout.times.numpy(),
        "rollout": reading.rollout.positions.numpy(),
    }
    if changed is not None:
        arrays["changed"] = changed.positions.numpy()

    def save(partial: Path) -> None:
        with partial.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    write_with(path, save)


def _show(run: RunFolder, reading: Reading, changed: Forecast | None, console: Console) -> None:
    for name, found in (("the law that held", reading.rollout), ("the changed law", changed)):
        if found is None:
            continue
        for finding in found.findings:
            console.warn(f"{name}: {finding}")
        last = ", ".join(f"({x:.4g}, {y:.4g})" for x, y in found.positions[-1].tolist())
        console.result(f"{name}: at {float(found.times[-1]):.4g} s {last}")
    console.result(f"arrays: {run.path / 'rollout.npz'}")
    console.result(f"recording: {run.path / 'recordings' / 'rollout.rrd'}")
