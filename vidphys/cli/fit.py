"""``vidphys fit``: exactly the model that a diagnosis asks for, trained on its tracks."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.options import given_columns, require_file
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.reading.specified import Trained
    from vidphys.runs.folder import RunFolder
    from vidphys.runs.records import Recorder

CELL = "tracks/specified"
ELSEWHERE = ("tracks", "specification", "out", "on_nan", "overwrite", "quiet")


@dataclass(frozen=True)
class FitConfig:
    """Train exactly the model that a diagnosis asks for, on its tracks.

    Example: vidphys fit tracks.csv --specification runs/diagnosis/specification.json

    What the training has not seen is foretold, and scored beside bodies that stay where they were.

    Args:
        tracks: a table of times and positions, of any kind that `vidphys diagnose` reads.
        specification: the file of that name which `vidphys diagnose` wrote of it.
        out: the run folder.
        columns: what columns of the table are, as `vidphys diagnose` was told.
        start: first frame that is used.
        stop: frame to stop before.
        train_share: the share of the frames that is trained on, from the first.
        steps: optimiser steps of the training.
        seed: of the random initial weights and batch order.
        on_nan: what a loss or gradient that is not finite does: stop ends the training at the
            checkpoint before it; skip leaves the batch out, of up to a tenth of all steps.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    tracks: Annotated[Path, tyro.conf.Positional]
    specification: Path
    out: Path = Path("runs/fit")
    columns: tuple[str, ...] = ()
    start: int = 0
    stop: int | None = None
    train_share: float = 0.6
    steps: int = 400
    seed: int = 0
    on_nan: Literal["stop", "skip"] = "stop"
    overwrite: bool = False
    quiet: bool = False


def fit(config: FitConfig) -> int:
    """See :class:`FitConfig`.

    Returns:
        0, or 1 where the training's loss or gradient was not finite.

    Raises:
        InputError: a table or a specification that cannot be read, or that do not belong together;
            options that make no sense; another run in the folder.
    """
    if config.steps < 1:
        raise InputError(f"--steps {config.steps}: must be at least 1")
    if not 0 < config.train_share <= 1:
        raise InputError(f"--train-share {config.train_share}: must be above 0 and at most 1")
    given = given_columns(config.columns)
    require_file(config.tracks, "give a table of tracks")
    require_file(config.specification, "`vidphys diagnose` writes one")
    from dynamics.terms import TERMS, to_config
    from vidphys.cli.fitted import TRACKS
    from vidphys.data.formats import sources_of
    from vidphys.diagnose.explanations.specification import read_specification
    from vidphys.diagnose.recordings.release import free_frames
    from vidphys.diagnose.recordings.tables import read_tracks, write_tracks
    from vidphys.reading.fitted import save_fitted
    from vidphys.reading.specified import train_specified
    from vidphys.runs.atomic import sha256, write_with
    from vidphys.runs.folder import RunFolder
    from viz.told import write_told

    term, held = read_specification(config.specification)
    motion = read_tracks(config.tracks, given, float(held["interval_seconds"])).motion
    try:
        motion = motion.cut(config.start, config.stop)
    except ValueError as error:
        raise InputError(f"--start {config.start} --stop {config.stop}: {error}") from error
    motion = motion.cut(*free_frames(motion))
    end = round(config.train_share * motion.positions.shape[1])
    names = {TERMS.name_of(type(part)) for part in term.parts()}
    about = {
        **{key: value for key, value in asdict(config).items() if key not in ELSEWHERE},
        "experiment": "fit",
        "cells": [CELL],
        "seeds": [config.seed],
        "sha256": [sha256(config.tracks), sha256(config.specification)],
        "terms": to_config(term),
        "clip_sha256": _clip_of(config.tracks),
        "sources": sources_of(config.tracks) | TERMS.sources(*names),
    }
    with (
        RunFolder.at_work(config.out, about, config.overwrite) as run,
        Console(config.quiet, 1, "fit") as console,
    ):

        def show(step: int, steps: int, _loss: float) -> None:
            console.stage(("fit", step, steps))

        try:
            how = config.steps, config.seed, show, config.on_nan
            found = train_specified(term, held, motion, end, *how)
        except InputError:
            run.abandon()
            raise
        except FloatingPointError as error:
            console.warn(f"{error}; try fewer frames, or --on-nan skip")
            return 1
        save_fitted(run.checkpoints("heads"), found.model, config.steps)
        write_with(run.path / TRACKS, lambda path: write_tracks(path, found.tracks))
        recorder = _record(config, found)
        run.finish(f"specified-s{config.seed}", *recorder.tables())
        run.join()
        with console.drawing("the recording"):
            _draw(run, found, config.tracks.name)
        with console.drawing("the report"):
            write_told(run.path)
        console.done(0)
        for row in recorder.rows:
            console.result(f"{row['head']:<18}{row['metric']:<34}{row['value']:.4g}")
    return 0


def _draw(run: RunFolder, found: Trained, name: str) -> None:
    """The forecast, to be looked at."""
    from vidphys.cli.recordings import write_tracks_recording

    if found.forecast is not None:
        write_tracks_recording(
            run.path / "recordings" / f"{CELL.replace('/', '-')}.rrd",
            (found.tracks.times[0], found.tracks.positions[0]),
            {"rollout": (found.forecast.times, found.forecast.positions)},
            {"cell": CELL, "tracks": name},
        )


def _clip_of(tracks: Path) -> str | None:
    """The hash of the clip whose tracks a diagnosis left there, where it did."""
    from vidphys.cli.fitted import TRACKS
    from vidphys.runs.folder import RunFolder

    folder = RunFolder(tracks.parent)
    if tracks.name != TRACKS or not folder.manifest_path.is_file():
        return None
    settings = folder.manifest()["settings"]
    return settings.get("input_sha256") if settings.get("experiment") == "diagnose" else None


def _record(config: FitConfig, found: Trained) -> Recorder:
    from dynamics.building import parameter_count
    from vidphys.reading.numbers import numbers_of
    from vidphys.runs.records import Origin, Recorder

    origin = Origin(
        experiment="fit",
        cell=CELL,
        system=config.tracks.name,
        grounding="tracks",
        encoder="none",
        binder="none",
        readout="none",
        head="specified",
        seed=config.seed,
        device="cpu",
        dtype="float32",
    )
    recorder = Recorder(origin)
    recorder.add_value("parameters", parameter_count(found.model.head))
    for name, value in numbers_of(found.model).items():
        recorder.add_value(name, value)
    if found.error is not None and found.still is not None:
        recorder.add_value("forecast_rmse", found.error)
        recorder.add_value("forecast_rmse_persistence", found.still)
    return recorder
