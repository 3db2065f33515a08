"""``vidphys train``: readouts over a frozen encoder, and the dynamics of what they see."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.from_atlas import AUTO, with_atlas
from vidphys.cli.options import MOTION, given_columns, make_binder, refuse
from vidphys.cli.profiles import with_profile
from vidphys.cli.seeing import SeeingOptions
from vidphys.cli.train_settings import check, settings_of
from vidphys.cli.who import WhoOptions
from vidphys.devices import device_name, prepare_device
from vidphys.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from binders.base import Binder
    from vidphys.data.clip_files import Dataset
    from vidphys.progress import Progress
    from vidphys.reading.reader import Layer, LoadedEncoder
    from vidphys.reading.seen_clips import SeenClip
    from vidphys.runs.folder import RunFolder
    from vidphys.runs.records import Recorder

# where things lie and what is shown make no other run
ELSEWHERE = (
    "data",
    "store",
    "out",
    "weights",
    "on_nan",
    "from_atlas",
    "profile",
    "overwrite",
    "quiet",
)


@dataclass(frozen=True)
class TrainConfig(WhoOptions, SeeingOptions):
    """Train readouts and dynamics on a clip, a folder of clips, or a rendered folder.

    Example: vidphys train clips --seeds 3 --out runs/clips

    Positions are learned from a table beside each clip (NAME.csv with columns x1,y1,... or
    u1,v1,...; any table that `vidphys diagnose` reads), or else from a hand-made binder that
    follows what moves. Interrupted, the same command goes on where it was.

    Args:
        data: a video file, a folder of them, a folder of `vidphys render`, or a data set (of
            LeRobot, Hugging Face, WebDataset, HDF5, NPZ).
        columns: what columns of the tables are, where their names do not tell (u1=LEFT v1=TOP), or
            which of their bodies are learned (u=u2 v=v2).
        store: folder of the feature store; what is missing in it is extracted.
        store_dtype: of the values there, as `vidphys extract --store-dtype` wrote them.
        out: the run folder.
        readout: what reads positions from features: refined (attention says about where, several
            readers of the cells around it say where exactly, and how sure that is), attention
            alone, pooled, or package.module:name; auto is refined, or with --from-atlas what reads
            the form that was best there. An option that it does not take is refused.
        layers: of the encoder that are read, its own default if none is named. Every combination
            of layer, width, readers, learning rate and seed is trained beside a pooled control of
            as many parameters, and the best on what is held out is kept.
        widths: channels of the attention, multiples of 4, or of the pooled network; 128.
        readers: how many networks read the cells around a body; their mean is taken; 3.
        mirrors: read the clips that are scored, and later ones, with their mirror images: four
            times the cost, for a smaller error.
        learning_rates: those of the readouts, each of which is tried.
        seeds: how many initial weights are tried, counted from --seed.
        steps: optimiser steps of each readout; 5400 refined, else 1200.
        batch: feature frames a step; 128 refined, else 16.
        patience: evaluations (of 40) without a smaller held-out error that end a readout's
            training; 0 ends none early.
        shift: move training features by up to so many cells, so that few labels show more places;
            4, and none of the pooled ones.
        binder: what follows the bodies where no table tells the positions: motion, or
            package.module:name.
        bodies: how many it follows; 1.
        shadow: darkening, as a factor of the background's brightness, that motion takes for a
            shadow rather than a body; 1 keeps every change. Found out unless given.
        train_share: the share of the clips that is trained on; of a single clip, its first part.
        split_by: clip; time, which cuts every clip; the name of a fact of the clips (a column of a
            data set), those of which stay together; or auto: as the data set says, else by clip. A
            clip that would be in two splits is an error.
        heads: those trained beside factored and its twin unstructured; `vidphys parts` names them.
        head_steps: optimiser steps of each dynamics head.
        friction: whether the factored head has friction; auto leaves it out where the data set
            says that it has none.
        beyond: seconds to roll past the end of the recorded clip.
        seed: draws batch orders and dynamics heads, and is the first of the readouts' seeds.
        on_nan: what a loss or gradient that is not finite does: stop ends the training at the
            checkpoint before it; skip leaves the batch out, of up to a tenth of all steps.
        from_atlas: run folder of `vidphys atlas`, whose encoder, layer and readout for positions
            are taken.
        profile: settings for this verb, from a file that `vidphys trade --pick ... --save` wrote.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    data: Annotated[Path, tyro.conf.Positional]
    columns: tuple[str, ...] = ()
    store: Path = Path("features")
    store_dtype: Literal["float16", "bfloat16", "float32", "int8"] = "float16"
    out: Path = Path("runs/clip")
    readout: str = AUTO
    layers: tuple[int | str, ...] = ()
    widths: tuple[int, ...] = ()
    readers: tuple[int, ...] = ()
    mirrors: bool = True
    learning_rates: tuple[float, ...] = (3e-3,)
    seeds: int = 1
    steps: int | None = None
    batch: int | None = None
    patience: int = 20
    shift: int | None = None
    binder: str | None = None
    bodies: int | None = None
    shadow: float | None = None
    train_share: float = 0.6
    split_by: str = "auto"
    heads: tuple[str, ...] = ()
    head_steps: int = 400
    friction: Literal["auto", "yes", "no"] = "auto"
    beyond: float = 3.0
    seed: int = 0
    on_nan: Literal["stop", "skip"] = "stop"
    from_atlas: Path | None = None
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
    config = with_atlas(with_profile(config, "train"))
    from vidphys.data.dataset import find_dataset

    dataset = find_dataset(config.data, given_columns(config.columns))  # before slow imports
    from vidphys.reading.reader import load_layers
    from vidphys.runs.folder import RunFolder

    check(config)
    binder = make_binder(config.binder, config.bodies, config.shadow, config)
    prepare_device(config.device)
    if dataset.labelled:
        why = f"the tables of {config.data} tell the positions"
        refuse(config, (*config.given, "binder", "bodies", "shadow"), why)
    else:
        refuse(config, ("columns",), f"{config.data} has no tables of positions")
    layers, options = config.layers or (None,), config.encoder_options
    try:
        encoders = load_layers(config.encoder, options, layers, config.weights, config.device)
    except ValueError as error:
        raise InputError(str(error)) from error
    part = f"train-s{config.seed}"
    with (
        RunFolder.at_work(config.out, _about(config, dataset, encoders), config.overwrite) as run,
        Console(config.quiet, 4, "train") as console,
    ):
        if not (run.is_done(part) and _recording(run).exists()):  # which is drawn last
            try:
                _train(config, dataset, encoders, binder, run, console)
            except InputError:
                run.abandon()
                raise
            except FloatingPointError as error:
                console.warn(f"{error}; try smaller --learning-rates, or --on-nan skip")
                return 1
        _show(run, console)
    return 0


def _about(
    config: TrainConfig, dataset: Dataset, encoders: dict[Layer, LoadedEncoder]
) -> dict[str, Any]:
    """What makes the run this run, for ``run.json``."""
    from binders import BINDERS
    from dynamics import HEADS
    from encoders.frozen import ENCODERS
    from readouts import READOUTS
    from vidphys.data.formats import sources_of
    from vidphys.reading.clip_dynamics import FACTORED, UNSTRUCTURED

    given = {key: value for key, value in asdict(config).items() if key not in ELSEWHERE}
    return {
        **given,
        "experiment": "train",
        "cells": [f"clip/{name}" for name in (FACTORED, UNSTRUCTURED, *config.heads)],
        "readout_seeds": given.pop("seeds"),
        "seeds": [config.seed],
        "identities": [asdict(encoder.network.identity) for encoder in encoders.values()],
        "sha256": dataset.hashes,
        "sources": {
            **ENCODERS.sources(config.encoder),
            **READOUTS.sources(config.readout),
            **BINDERS.sources(config.binder or MOTION),
            **HEADS.sources(*config.heads),
            **sources_of(*dataset.paths),
        },
    }


def _train(
    config: TrainConfig,
    dataset: Dataset,
    encoders: dict[Layer, LoadedEncoder],
    binder: Binder,
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

    settings, checkpoints = settings_of(config), run.checkpoints("training")
    selection = settings.selection
    try:
        store = FeatureStore(config.store)
        with console.busy("looking at the clips"):
            clips = see(dataset, encoders, store, selection, binder, stage, config.store_dtype)
        _tell(run, console, dataset, clips)
        console.done(0)
        perceived = perceive(clips, dataset, encoders, store, settings, checkpoints, stage)
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
    recorder = _recorder(config, dataset)
    record_readouts(recorder, perceived)
    record_forecasts(recorder, perceived, pipeline, told)
    run.finish(f"train-s{config.seed}", *recorder.tables())
    with console.drawing("the recording"):
        record_training(run.path, perceived, told[0], selection)
    console.done(3)


def _tell(run: RunFolder, console: Console, dataset: Dataset, clips: Sequence[SeenClip]) -> None:
    """Say, and keep, where positions come from and what is odd about the clips."""
    labels = dataset.told(clips[0].labels.positions.shape[2])
    console.note(labels)
    for clip in clips:
        for note in clip.about["notes"]:
            console.note(f"{clip.file.path}: note: {note}")
    run.tell(labels=labels, clips=[dict(clip.about) for clip in clips])


def _recorder(config: TrainConfig, dataset: Dataset) -> Recorder:
    from vidphys.runs.records import Origin, Recorder

    return Recorder(
        Origin(
            experiment="train",
            cell="clip",
            system=config.data.name,
            grounding=config.encoder,
            encoder=config.encoder,
            binder="table" if dataset.labelled else config.binder or MOTION,
            readout=config.readout,
            head="none",
            seed=config.seed,
            device=device_name(config.device),
            dtype=config.dtype or "float32",
        )
    )


def _show(run: RunFolder, console: Console) -> None:
    from viz.told import write_told

    rows = run.join().to_pylist()
    with console.drawing("the report"):
        write_told(run.path)
    for row in rows:
        value = "failed" if row["value"] is None else f"{row['value']:.4g}"
        console.result(f"{row['cell']:<50}{row['metric']:<28}{value}")
    recording = _recording(run)
    if recording.exists():
        console.result(f"recording: {recording}")


def _recording(run: RunFolder) -> Path:
    return run.path / "recordings" / "clip.rrd"
