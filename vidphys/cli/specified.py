"""``vidphys train --specification``: exactly the model that a diagnosis asks for, on its tracks."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from vidphys.cli.console import Console
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.cli.train import TrainConfig

TRAINED = ("head_steps", "seed", "train_share", "start", "stop", "device")


def train_on_tracks(config: TrainConfig) -> int:
    """Train a model of the specification's terms on a table of tracks.

    Returns:
        0.

    Raises:
        InputError: a table or a specification that cannot be read, or that do not belong together.
    """
    from dynamics.build import parameter_count
    from dynamics.terms import to_config
    from vidphys.diagnose.recordings.release import free_frames
    from vidphys.diagnose.recordings.tables import read_motion
    from vidphys.diagnose.telling.specification import read_specification
    from vidphys.reading.specified import train_specified
    from vidphys.runs import checkpoint
    from vidphys.runs.atomic import sha256
    from vidphys.runs.folder import RunFolder
    from vidphys.runs.records import Origin, Recorder

    assert config.specification is not None
    terms, held = read_specification(config.specification)
    motion = read_motion(config.data, interval=float(held["interval_seconds"])).motion
    motion = motion.cut(config.start, config.stop)
    motion = motion.cut(*free_frames(motion))
    end = round(config.train_share * motion.positions.shape[1])
    about = {
        **{name: getattr(config, name) for name in TRAINED},
        "experiment": "train-specified",
        "cells": ["tracks/specified"],
        "seeds": [config.seed],
        "sha256": [sha256(config.data), sha256(config.specification)],
        "terms": to_config(terms),
    }
    run = RunFolder.open(config.out, about, config.overwrite)
    with run.locked(), Console(config.quiet, 1, "train") as console:

        def show(step: int, steps: int, _loss: float) -> None:
            console.stage(("train", step, steps))

        try:
            found = train_specified(terms, held, motion, end, config.head_steps, config.seed, show)
        except InputError:
            run.abandon()
            raise
        origin = Origin(
            "train-specified",
            "tracks/specified",
            config.data.name,
            "tracks",
            "none",
            "none",
            "none",
            "specified",
            config.seed,
            config.device,
            "float32",
        )
        recorder = Recorder(origin)
        recorder.add_value("parameters", parameter_count(found.head))
        if found.error is not None and found.still is not None:
            recorder.add_value("forecast_rmse", found.error)
            recorder.add_value("forecast_rmse_persistence", found.still)
        meta = {
            "step": config.head_steps,
            "terms": to_config(terms),
            "bodies": motion.bodies,
            "space": motion.space,
            "origin": held["origin"],
            "units": asdict(found.units),
        }
        path = run.checkpoints("heads") / "specified.json"
        checkpoint.save(path, dict(found.head.state_dict()), meta)
        run.finish(f"specified-s{config.seed}", *recorder.tables())
        run.join()
        console.done(0)
        for row in recorder.rows:
            console.result(f"{row['head']:<18}{row['metric']:<34}{row['value']:.4g}")
    return 0
