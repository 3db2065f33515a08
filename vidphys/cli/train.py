"""``vidphys train``: readouts over a frozen encoder, and the dynamics of what they see."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.profiles import with_profile
from vidphys.cli.seeing import SeeingOptions
from vidphys.devices import check_cuda
from vidphys.errors import InputError

if TYPE_CHECKING:
    from binders.motion import MotionSettings
    from vidphys.data.dataset import Dataset
    from vidphys.progress import Progress
    from vidphys.reading.reader import Layer, LoadedEncoder
    from vidphys.reading.training import TrainSettings
    from vidphys.runs.folder import RunFolder
    from vidphys.runs.records import Recorder

HEADS = 4  # by which the width of a readout's attention is divided
# where things lie and what is shown make no other run
ELSEWHERE = ("data", "store", "out", "weights", "profile", "overwrite", "quiet")


@dataclass(frozen=True)
class TrainConfig(SeeingOptions):
    """Train readouts and dynamics on a clip, a folder of clips, or a rendered folder.

    Example: vidphys train clips --encoder hiera --widths 64 128 --seeds 3 --out runs/clips

    Positions are learned from a table beside each clip (NAME.csv with columns x1,y1,... or
    u1,v1,...), or else from a hand-made binder that follows what moves. Interrupted, the same
    command goes on where it was.

    Args:
        data: a video file, a folder of them, or a folder of `vidphys render`.
        store: folder of the feature store; what is missing in it is extracted.
        out: the run folder.
        layers: of the encoder that are read, its own default if none is named.
        widths: of the readouts, multiples of 4; every combination of layer, width, learning rate
            and seed is trained, and the best on what is held out is kept.
        learning_rates: of the readouts.
        seeds: initial weights that are tried, counted from seed.
        steps: optimiser steps of each readout.
        batch: feature frames a step.
        patience: evaluations (of 40) without a smaller held-out error that end a readout's
            training; 0 ends none early.
        shift: move training features by up to so many cells, so that few labels show more places.
        bodies: that the hand-made binder follows.
        shadow: darkening, as a factor of the background's brightness, that it takes for a shadow
            rather than a body; 1 where bodies differ from it in brightness alone.
        train_share: of the clips that is trained on; of a single clip, its first part.
        head_steps: optimiser steps of each dynamics head.
        friction: whether the factored head has friction; auto leaves it out where the data set
            says that it has none.
        beyond: seconds to roll past the end of the recorded clip.
        seed: of batch orders and dynamics heads, and the first of the readouts' seeds.
        profile: take what it sets of this verb from a point that `vidphys trade --pick` chose.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    data: Annotated[Path, tyro.conf.Positional]
    store: Path = Path("features")
    out: Path = Path("runs/clip")
    layers: tuple[int | str, ...] = ()
    widths: tuple[int, ...] = (128,)
    learning_rates: tuple[float, ...] = (3e-3,)
    seeds: int = 1
    steps: int = 1200
    batch: int = 16
    patience: int = 20
    shift: int = 4
    bodies: int = 1
    shadow: float = 0.6
    train_share: float = 0.6
    head_steps: int = 400
    friction: Literal["auto", "yes", "no"] = "auto"
    beyond: float = 3.0
    seed: int = 0
    profile: Path | None = None
    overwrite: bool = False
    quiet: bool = False


def train(config: TrainConfig) -> int:
    """See :class:`TrainConfig`.

    Returns:
        0, or 1 where every readout's loss became infinite.

    Raises:
        InputError: data that cannot be read or trained on, options that make no sense, weights
            that are missing or wrong, a device that is not there, or another run in the folder.
    """
    config = with_profile(config, "train")
    from vidphys.cli.binder import binder_settings
    from vidphys.data.dataset import find_dataset
    from vidphys.reading.reader import load_layers
    from vidphys.runs.folder import RunFolder

    _check(config)
    binder = binder_settings(config.bodies, config.shadow)
    check_cuda(config.device)
    dataset = find_dataset(config.data)
    layers, options = config.layers or (None,), config.encoder_options
    try:
        encoders = load_layers(config.encoder, options, layers, config.weights, config.device)
    except ValueError as error:
        raise InputError(str(error)) from error
    run = RunFolder.open(config.out, _about(config, dataset, encoders), config.overwrite)
    part = f"train-s{config.seed}"
    with run.locked(), Console(config.quiet, 4, "train") as console:
        if not run.is_done(part):
            try:
                _train(config, dataset, encoders, binder, run, console)
            except InputError:
                run.abandon()
                raise
            except FloatingPointError as error:
                console.warn(f"{error}; try smaller --learning-rates")
                return 1
        _show(run, console)
    return 0


def _check(config: TrainConfig) -> None:
    counts = ("seeds", "steps", "batch", "head_steps")
    for name, least in (*((name, 1) for name in counts), ("patience", 0), ("shift", 0)):
        if getattr(config, name) < least:
            option = name.replace("_", "-")
            raise InputError(f"--{option} {getattr(config, name)}: must be at least {least}")
    for width in config.widths:
        if width < HEADS or width % HEADS:
            raise InputError(f"--widths {width}: must be a multiple of {HEADS}")
    for rate in config.learning_rates:
        if not 0 < rate < float("inf"):
            raise InputError(f"--learning-rates {rate}: must be above 0")
    if not config.widths or not config.learning_rates:
        raise InputError("--widths, --learning-rates: name at least one of each")
    if not config.beyond >= 0:
        raise InputError(f"--beyond {config.beyond}: must be at least 0 seconds")


def _about(
    config: TrainConfig, dataset: Dataset, encoders: dict[Layer, LoadedEncoder]
) -> dict[str, Any]:
    """What makes the run this run, for ``run.json``."""
    from encoders.frozen import ENCODERS
    from vidphys.reading.clip_dynamics import FACTORED, UNSTRUCTURED

    given = {key: value for key, value in asdict(config).items() if key not in ELSEWHERE}
    return {
        **given,
        "experiment": "train",
        "cells": [f"clip/{FACTORED}", f"clip/{UNSTRUCTURED}"],
        "readout_seeds": given.pop("seeds"),
        "seeds": [config.seed],
        "identities": [asdict(encoder.network.identity) for encoder in encoders.values()],
        "sha256": dataset.hashes,
        "sources": ENCODERS.sources(config.encoder),
    }


def _settings(config: TrainConfig) -> TrainSettings:
    from vidphys.reading.training import TrainSettings
    from vidphys.training.candidates import Grid
    from vidphys.training.early_stopping import StopSettings
    from vidphys.training.learner import FitSettings
    from vidphys.training.readouts import ReadoutSettings

    fit = FitSettings(config.steps, config.batch, config.learning_rates[0])
    readout = ReadoutSettings(fit, config.shift, StopSettings(patience=config.patience))
    seeds = tuple(range(config.seed, config.seed + config.seeds))
    grid = Grid(config.widths, config.learning_rates, seeds)
    return TrainSettings(
        readout, grid, config.selection, config.train_share, config.head_steps, config.seed
    )


def _train(
    config: TrainConfig,
    dataset: Dataset,
    encoders: dict[Layer, LoadedEncoder],
    binder: MotionSettings,
    run: RunFolder,
    console: Console,
) -> None:
    from encoders.store import FeatureStore
    from vidphys.cli.recordings import record_training
    from vidphys.reading.pipeline import save_pipeline
    from vidphys.reading.scores import foretell, record_forecasts, record_readouts
    from vidphys.reading.seen_clips import see
    from vidphys.reading.training import perceive, understand

    def stage(name: str) -> Progress:
        return lambda step, steps, _: console.stage((name, step, steps))

    settings, checkpoints = _settings(config), run.checkpoints("training")
    selection = settings.selection
    try:
        clips = see(dataset, encoders, FeatureStore(config.store), selection, binder, stage)
        console.done(0)
        perceived = perceive(clips, dataset, encoders, settings, checkpoints, stage)
        console.done(1)
        friction = config.friction == "yes" or (
            config.friction == "auto" and not dataset.conserving
        )
        pipeline = understand(perceived, friction, settings, checkpoints, stage)
        told = foretell(perceived, pipeline, config.beyond)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error)) from error
    console.done(2)
    save_pipeline(run.path / "checkpoints", pipeline)
    record_training(run.path, perceived, told[0], selection)
    recorder = _recorder(config, dataset)
    record_readouts(recorder, perceived)
    record_forecasts(recorder, perceived, pipeline, told)
    run.finish(f"train-s{config.seed}", *recorder.tables())
    console.done(3)


def _recorder(config: TrainConfig, dataset: Dataset) -> Recorder:
    from vidphys.runs.records import Origin, Recorder

    return Recorder(
        Origin(
            experiment="train",
            cell="clip",
            system=config.data.name,
            grounding=config.encoder,
            encoder=config.encoder,
            binder="table" if dataset.labelled else "motion",
            readout="attention",
            head="none",
            seed=config.seed,
            device=config.device,
            dtype=config.dtype or "float32",
        )
    )


def _show(run: RunFolder, console: Console) -> None:
    for row in run.join().to_pylist():
        value = "failed" if row["value"] is None else f"{row['value']:.4g}"
        console.result(f"{row['cell']:<50}{row['metric']:<28}{value}")
    console.result(f"recording: {run.path / 'recordings' / 'clip.rrd'}")
