"""What `vidphys rollout` does with a model of `vidphys fit`: tracks on, also under another law."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vidphys.cli.console import Console
from vidphys.cli.options import given_columns, make_binder, refuse, require_file
from vidphys.cli.pushes import OPTIONS, named, told_push
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.cli.rollout import RolloutConfig
    from vidphys.data.frames import Frames
    from vidphys.diagnose.recordings.motion import Motion
    from vidphys.reading.fitted import Fitted, Rolled
    from vidphys.reading.steering import Aim

TRACKS = "tracks.csv"  # of the fit, in its run folder
OF_CLIPS = ("head", "weights")


@dataclass(frozen=True)
class Recorded:
    """What is rolled on from.

    Args:
        motion: the tracks.
        frames: of a clip, ``(t, H, W, 3)``, with their times ``(t,)``.
        notes: how it was understood.
    """

    motion: Motion
    frames: tuple[Frames, np.ndarray] | None = None
    notes: tuple[str, ...] = ()


def roll_fitted(config: RolloutConfig, aim: Aim | None = None) -> None:
    """Roll the model of a fit on from the end of some tracks, and perhaps with a push.

    Raises:
        InputError: an input that cannot be read or is of another scene, a law that the model does
            not have, options without effect, or another run in the folder.
    """
    from vidphys.reading.fitted import load_fitted
    from vidphys.reading.laws import factors_of
    from vidphys.runs.folder import RunFolder
    from viz.told import write_told

    refuse(config, OF_CLIPS, "the model of a fit needs no encoder")
    factors = factors_of(config.law)
    fitted = load_fitted(config.run)
    other = None
    if factors or config.coupling is not None or aim:
        other = fitted.under(factors, config.coupling)
    recorded = _recorded(config, fitted)
    if config.video is not None and recorded.frames is None:
        raise InputError("--video: a table has no frames to draw over; give the clip")
    motion = recorded.motion
    with (
        RunFolder.at_work(config.out, _about(config, motion), config.overwrite) as run,
        Console(config.quiet, 1, "rollout") as console,
    ):
        try:
            start, began, h = fitted.last(motion), float(motion.times[0, -1]), motion.interval
            frames = max(1, math.ceil(config.beyond / h - 1e-6))
            held = fitted.roll(start, began, frames, h, fitted.law(motion))
            changed = None
            if other is not None:
                ratio = (other.params.mass / fitted.params.mass).unsqueeze(-1)
                pushed = type(start)(start.q, start.p * ratio)  # as fast as it was
                law = other.params if config.coupling is not None else other.law(motion)
                changed = other.roll(pushed, began, frames, h, law, aim)
        except ValueError as error:
            run.abandon()
            raise InputError(f"{config.input or config.run}: {error}") from error
        _write(run.path / "rollout.npz", motion, held, changed)
        with console.drawing("the recording"):
            _draw(config, run.path, recorded, held, changed)
        with console.drawing("the report"):
            write_told(run.path)
        console.done(0)
        for note in recorded.notes:
            console.result(note)
        _show(run.path, fitted, held, changed, console)
        if config.video is not None:
            console.result(f"film: {config.video}")


def _recorded(config: RolloutConfig, fitted: Fitted) -> Recorded:
    from vidphys.data.dataset import is_clip
    from vidphys.data.sets import is_in_set
    from vidphys.diagnose.recordings.flat import laid
    from vidphys.diagnose.recordings.tables import read_tracks

    if config.input is not None and not is_in_set(config.input):
        require_file(config.input, "give the table or the clip that the model was fitted to")
    if config.input is not None and is_clip(config.input):
        refuse(config, ("columns",), f"{config.input} is a clip, not a table")
        return _of_clip(config, fitted)
    refuse(config, ("rate",), "there is no clip")
    if config.input is None:
        refuse(config, ("columns",), "the tracks of the fit are rolled on")
    source = config.input or config.run / TRACKS
    if not source.is_file():
        raise InputError(f"{config.run}: it kept no tracks; give the table that it was fitted to")
    loaded = read_tracks(source, given_columns(config.columns), fitted.interval)
    return Recorded(laid(_cut(config, loaded.motion), fitted.plane))


def _cut(config: RolloutConfig, motion: Motion) -> Motion:
    try:
        motion = motion.cut(config.start, config.stop)
        return motion.cut(*motion.shown())
    except ValueError as error:
        raise InputError(f"--start {config.start} --stop {config.stop}: {error}") from error


def _of_clip(config: RolloutConfig, fitted: Fitted) -> Recorded:
    """The tracks that the fit kept of this clip, or those that are followed in another one."""
    from vidphys.data.video import ClipSelection, open_video
    from vidphys.diagnose.recordings.clips import follow_clip
    from vidphys.diagnose.recordings.tables import read_tracks
    from vidphys.runs.folder import RunFolder

    assert config.input is not None
    selection = ClipSelection(config.start, config.stop, rate=config.rate)
    video = open_video(config.input, selection)
    pictures = video.frames, video.times
    settings = RunFolder(config.run).manifest()["settings"]
    if settings.get("clip_sha256") == video.sha256 and config.rate is None:
        motion = read_tracks(config.run / TRACKS, interval=fitted.interval).motion
        within = (motion.times[0] >= video.times[0] - 1e-6) & (
            motion.times[0] <= video.times[-1] + 1e-6
        )
        first, *_ = *np.flatnonzero(within), 0
        motion = motion.cut(int(first), int(first) + int(within.sum()))
        return Recorded(motion.cut(*motion.shown()), pictures)
    binder = make_binder(None, len(fitted.params.mass[0]), None)
    followed = follow_clip(config.input, selection, binder)
    motion = followed.motion
    said = "another clip than the fit's: its strongest movers are followed"
    return Recorded(motion.cut(*motion.shown()), pictures, (*followed.notes, said))


def _about(config: RolloutConfig, motion: Motion) -> dict[str, Any]:
    from vidphys.data.dataset import content_sha256
    from vidphys.reading.fitted import FILE
    from vidphys.runs.atomic import sha256

    kept = ("beyond", "coupling", "law", *OPTIONS, "start", "stop", "rate", "columns")
    source = config.input or config.run / TRACKS
    return {
        "experiment": "rollout",
        "cells": ["rollout"],
        "seeds": [],
        "fitted_sha256": sha256(config.run / "checkpoints" / "heads" / FILE),
        "input_sha256": content_sha256(source),
        "frames": motion.positions.shape[1],
        **{name: getattr(config, name) for name in kept},
    }


def _write(path: Path, motion: Motion, held: Rolled, changed: Rolled | None) -> None:
    from vidphys.cli.recordings import write_arrays

    arrays = {
        "times": motion.times[0],
        "track": motion.positions[0],
        "rollout_times": held.times,
        "rollout": held.positions,
    }
    if held.spread is not None:
        arrays["spread"] = held.spread
    if changed is not None:
        arrays["changed"] = changed.positions
    write_arrays(path, arrays)


def _draw(
    config: RolloutConfig, run: Path, recorded: Recorded, held: Rolled, changed: Rolled | None
) -> None:
    from vidphys.cli.recordings import told_law, write_tracks_recording

    paths = {"rollout": held} | ({} if changed is None else {"changed": changed})
    rolled = {name: (path.times, path.positions) for name, path in paths.items()}
    meta = {"cell": "rollout", "input": (config.input or config.run).name}
    if changed is not None:
        meta["law"] = told_law(config.coupling, config.law, changed.push)
    motion = recorded.motion
    write_tracks_recording(
        run / "recordings" / "rollout.rrd",
        (motion.times[0], motion.positions[0]),
        rolled,
        meta,
        recorded.frames,
        config.video,
    )


def _show(
    run: Path, fitted: Fitted, held: Rolled, changed: Rolled | None, console: Console
) -> None:
    for name, found in named(held, changed):
        for finding in found.findings:
            console.warn(f"{name}: {finding}")
        beyond = fitted.seen.left(found.times, found.positions)
        if beyond is not None:
            console.warn(f"{name} {beyond}: nothing there was ever checked")
        last = ", ".join(f"({', '.join(f'{x:.4g}' for x in q)})" for q in found.positions[-1])
        often = "" if found.spread is None else f" ± {found.spread[-1].mean():.2g} (one path)"
        console.result(
            f"{name}: at {float(found.times[-1]):.4g} s {last}{often}{told_push(found.push)}"
        )
    console.result(f"arrays: {run / 'rollout.npz'}")
    recording = run / "recordings" / "rollout.rrd"
    if recording.is_file():
        console.result(f"recording: {recording}")
