"""``vidphys rollout``: a trained model rolls a clip or a table on, also under another law."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.options import refuse
from vidphys.cli.profiles import with_profile
from vidphys.cli.pushes import OPTIONS, aim_of, named, told_push
from vidphys.devices import prepare_device
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.reading.forecasts import Forecast
    from vidphys.reading.pipeline import Reading
    from vidphys.reading.steering import Aim
    from vidphys.runs.folder import RunFolder


@dataclass(frozen=True)
class RolloutConfig:
    """Roll a trained model on from the last frame of a clip or a table.

    Example: vidphys rollout runs/fitted --beyond 5 --law friction=0 length=0.5 --out runs/changed

    With --reach it also says which push takes a body to a place: vidphys rollout runs/fitted
    --beyond 1.2 --reach 310 240 --body 2 (after 1.2 seconds, in the units below).

    Writes rollout.npz (positions as a camera without drift sees them, in the units of the
    training's labels or of the tracks) and a recording for `vidphys view`. A learned pair law is
    compiled into a spline for a long rollout, as run.json says.

    Args:
        run: folder of a finished `vidphys fit` or `vidphys train`.
        input: what is rolled on: a clip (the coupling and masses of a rendered one are known), or
            for a fit also a table; the tracks that it was fitted to where none is given.
        out: the folder that is written.
        beyond: seconds to roll past the last frame.
        coupling: also roll under this coupling in place of the one that held.
        law: also roll with numbers of the law multiplied, each NAME=FACTOR: friction=0, length=0.5,
            gravity=2, mass=2, mass2=3 (of one body), pair (what bodies do to each other),
            stiffness, restitution, centre (what a fixed place does), turning (a force across the
            way), lift, forcing (what a sinusoid does), and the strengths that the law is told, such
            as temperature, electric or drive; 0 takes a term away.
        reach: also look for a push, now, after which a body is at this place when the rollout ends;
            under the changed law, where one is given. The model has it so: how far that is to be
            trusted, `vidphys reproduce planning` shows for worlds whose truth is known.
        body: that is pushed and shall be there, from 1; the first if not given.
        most: largest change of its speed by the push, in the same unit a second; ten times what
            would do on a straight line, if not given.
        search: for a push: along slopes, if not given, or by the cross-entropy method, which asks
            the model more often and is not led astray by a slope.
        video: also draw the track, the forecast and the changed law over the clip's frames, into
            this .mp4 file.
        columns: what columns of a table are, as `vidphys diagnose` was told.
        head: of a training, the model that rolls: factored (unless told otherwise), its twin
            unstructured, or another.
        start: first frame that is read.
        stop: frame to stop before, from which it is rolled on.
        rate: frames per second, in place of the container's time stamps.
        weights: file or folder of the encoder's weights; else VIDPHYS_WEIGHTS.
        profile: settings for this verb, from a file that `vidphys trade --pick ... --save` wrote.
        device: where the encoder runs.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    run: Annotated[Path, tyro.conf.Positional]
    input: Annotated[Path | None, tyro.conf.Positional] = None
    out: Path = Path("runs/rollout")
    beyond: float = 3.0
    coupling: float | None = None
    law: tuple[str, ...] = ()
    reach: tuple[float, ...] = ()
    body: int | None = None
    most: float | None = None
    search: Literal["slopes", "cross-entropy"] | None = None
    video: Path | None = None
    columns: tuple[str, ...] = ()
    head: str | None = None
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
    if not config.beyond > 0:
        raise InputError(f"--beyond {config.beyond}: must be above 0 seconds")
    if not (config.run / "run.json").is_file():
        raise InputError(f"{config.run}: no folder of `vidphys train` or `fit`: it has no run.json")
    aim = aim_of(config)
    if (config.run / "checkpoints" / "heads" / "specified.json").is_file():
        from vidphys.cli.fitted import roll_fitted

        roll_fitted(config, aim)
    else:
        _roll_trained(config, aim)


def _roll_trained(config: RolloutConfig, aim: Aim | None) -> None:
    """With a pipeline, which sees for itself."""
    from vidphys.data.dataset import clip_file

    refuse(config, ("columns",), "a training rolls clips, not tables")
    if config.input is None:
        raise InputError(f"{config.run}: a training rolls what it sees; give a clip after it")
    file = clip_file(config.input)  # before anything slow is imported
    from vidphys.cli.recordings import record_rollout, told_law
    from vidphys.data.video import ClipSelection, open_video, require_frames
    from vidphys.reading.clip_dynamics import FACTORED
    from vidphys.reading.laws import factors_of
    from vidphys.reading.pipeline import load_pipeline
    from vidphys.runs.folder import RunFolder
    from viz.told import write_told

    prepare_device(config.device)
    factors = factors_of(config.law)
    try:
        pipeline = load_pipeline(config.run, config.weights, config.device)
    except ValueError as error:
        raise InputError(str(error)) from error
    how = pipeline.reader.stride, pipeline.reader.side, config.rate
    video = open_video(config.input, ClipSelection(config.start, config.stop, *how))
    require_frames(video)
    law, head = file.law(pipeline.reader.bodies), config.head or FACTORED
    with (
        RunFolder.at_work(config.out, _about(config, video.sha256), config.overwrite) as run,
        Console(config.quiet, 1, "rollout") as console,
    ):
        try:
            reading = pipeline(video.frames, video.times, law, config.beyond, head)
            changed = None
            if config.coupling is not None or factors or aim:
                other = law if config.coupling is None else law.with_coupling(config.coupling)
                began = float(video.times[-1])
                asked = config.beyond, head, factors, aim
                changed = pipeline.roll(reading.state, began, other, *asked)
        except ValueError as error:
            run.abandon()
            raise InputError(f"{config.input}: {error}") from error
        _write(run.path / "rollout.npz", reading, changed)
        run.tell(
            rolled={k: x.ran and asdict(x.ran) for k, x in named(reading.rollout, changed)},
            flags={
                x.name: {**asdict(x), "raised": x.raised, "said": str(x)} for x in reading.flags
            },
        )
        extent = pipeline.reader.half_extent
        with console.drawing("the recording"):
            words = told_law(config.coupling, config.law, aim)
            record_rollout(run.path, video, reading, changed, extent, config.video, words)
        with console.drawing("the report"):
            write_told(run.path)
        console.done(0)
        _show(run, reading, changed, console)


def _about(config: RolloutConfig, sha256: str) -> dict[str, Any]:
    from vidphys.reading.pipeline import FILE
    from vidphys.runs.atomic import sha256 as hash_of

    kept = ("beyond", "coupling", "law", *OPTIONS, "head", "start", "stop", "rate")
    return {
        "experiment": "rollout",
        "cells": ["rollout"],
        "seeds": [],
        "pipeline_sha256": hash_of(config.run / "checkpoints" / FILE),
        "clip_sha256": sha256,
        **{name: getattr(config, name) for name in kept},
    }


def _write(path: Path, reading: Reading, changed: Forecast | None) -> None:
    from vidphys.cli.recordings import write_arrays

    arrays = {
        "times": reading.tracks.times.numpy(),
        "track": reading.tracks.positions[0].numpy(),
        "confidence": reading.tracks.confidence[0].numpy(),
        "camera": reading.camera.numpy(),
        "rollout_times": reading.rollout.times.numpy(),
        "rollout": reading.rollout.positions.numpy(),
    }
    if changed is not None:
        arrays["changed"] = changed.positions.numpy()

    write_arrays(path, arrays)


def _show(run: RunFolder, reading: Reading, changed: Forecast | None, console: Console) -> None:
    from vidphys.reading.seen import Seen

    for flag in reading.flags:
        if flag.raised:
            console.warn(f"the clip is unlike those of the training: {flag}")
    for name, found in named(reading.rollout, changed):
        for finding in found.findings:
            console.warn(f"{name}: {finding}")
        seen = Seen.of(reading.tracks.times.numpy(), reading.tracks.positions[0].numpy())
        beyond = seen.left(found.times.numpy(), found.positions.numpy())
        if beyond is not None:
            console.warn(f"{name} {beyond}: nothing there was ever checked")
        last = ", ".join(f"({x:.4g}, {y:.4g})" for x, y in found.positions[-1].tolist())
        console.result(f"{name}: at {float(found.times[-1]):.4g} s {last}{told_push(found.push)}")
    console.result(f"arrays: {run.path / 'rollout.npz'}")
    recording = run.path / "recordings" / "rollout.rrd"
    if recording.exists():
        console.result(f"recording: {recording}")
