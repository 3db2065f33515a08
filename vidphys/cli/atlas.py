"""``vidphys atlas``: what each layer of frozen encoders knows of each target, beside controls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.options import given_columns, refuse
from vidphys.cli.units import EngineOptions, run_units
from vidphys.data.video import ClipSelection
from vidphys.devices import prepare_device
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.probing.atlas import AtlasSettings, AtlasUnit
    from vidphys.probing.known import Known
    from vidphys.runs.folder import RunFolder

SCHEMA = 1  # of atlas.json


@dataclass(frozen=True)
class AtlasConfig(EngineOptions):
    """Map what each layer of frozen encoders knows of each target, beside all controls.

    Example: vidphys atlas clips --encoders dino-tiny vjepa2-tiny --out runs/atlas

    The report shows a heat map, cost beside accuracy, and for each target which encoder to take at
    which layer. More encoders on the same command add rows; interrupted, it goes on where it was.

    Args:
        data: whatever `vidphys train` reads: a folder of `vidphys render`, a folder of clips with a
            table of labels beside each, or a data set.
        columns: what columns of the tables are, where their names do not tell (u1=LEFT v1=TOP), or
            which of their bodies are asked about (u=u2 v=v2).
        out: the run folder.
        encoders: frozen encoders, by a name of `vidphys parts`, timm:NAME, hf:FOLDER or
            package.module:factory.
        layers: of each encoder that are read; all if none is named.
        device: where the encoders run.
        targets: position, velocity, speed, direction, acceleration, force, momentum, mass, charge,
            coupling, contact, count, or column:, angle: (radians) or class: and the name of a
            column of the tables or of a fact of the clips; of the former all that the tables tell
            if none is named.
        readout: linear takes for each target all cells of a map (cells), their mean (pooled) or
            where each channel speaks (softmax), whichever does best on clips left out; each of
            these; two-stage reads positions, and all else from their track; attention is trained
            over the cells, and slow; local reads the features at each body's true place.
        widths: channels of attention, 32 if none is named; all are tried side by side, and the best
            on clips held out is taken.
        rates: those of its learning, likewise; 0.003 if none is named.
        each: frames of each clip that are read, evenly spread.
        grid: cells on a side that maps are pooled to at most.
        folds: into how many parts the clips are cut; each part is tested by a readout that has not
            seen it.
        split_by: clip; the name of a fact of the clips (a column of a data set), those of which
            stay together in the folds; or auto: by clip. Cameras that saw the same always stay
            together, and a clip that would be in two folds is an error.
        kept: also ask what cheaper ways to keep features cost in accuracy: int8, 4x4 (cells), or
            4x4-int8.
        store: folder of the feature store; what is missing in it is extracted.
        weights: folder of encoders' weights; else VIDPHYS_WEIGHTS, else the user's cache.
        seed: the first seed, of folds, random weights and draws. Those below 100 are for
            development; figures are reported from 100.
        seeds: how many from there on.
        start: first frame of each clip that is seen.
        stop: frame to stop before.
        stride: take each so-many-th frame.
        side: shrink frames so that their longer side has at most this many pixels.
        rate: frames per second, in place of the container's time stamps.
        resample: take the frames nearest to so many a second, of clips whose frames come unevenly.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    data: Annotated[Path, tyro.conf.Positional]
    columns: tuple[str, ...] = ()
    out: Path = Path("runs/atlas")
    encoders: tuple[str, ...] = ("dino-tiny", "videomae-tiny", "vjepa2-tiny")
    layers: tuple[int | str, ...] = ()
    device: Literal["cpu", "cuda"] = "cpu"
    targets: tuple[str, ...] = ()
    readout: str = "linear"
    widths: tuple[int, ...] = ()
    rates: tuple[float, ...] = ()
    each: int = 2
    grid: int = 8
    folds: int = 5
    split_by: str = "auto"
    kept: tuple[Literal["int8", "4x4", "4x4-int8"], ...] = ()
    store: Path = Path("features")
    weights: Path | None = None
    seed: int = 0
    seeds: int = 1
    start: int = 0
    stop: int | None = None
    stride: int = 1
    side: int | None = None
    rate: float | None = None
    resample: float | None = None
    overwrite: bool = False
    quiet: bool = False


def atlas(config: AtlasConfig) -> int:
    """Do what is left of the atlas, then write its tables, choices and report.

    Returns:
        0, or 1 if an encoder failed; what others found is kept.

    Raises:
        InputError: clips or tables that cannot be read, a clip that is in two folds, an unknown
            name, options that make no sense, a device that is not there, or another run in the
            folder.
    """
    from vidphys.probing.atlas import AtlasUnit, settings_of
    from vidphys.runs.folder import RunFolder
    from vidphys.seeding import told

    _check(config)
    settings = _settings(config)
    seeds = range(config.seed, config.seed + config.seeds)
    about = settings_of(settings, config.encoders, seeds)
    units = [AtlasUnit(name, seed) for seed in seeds for name in config.encoders]
    with (
        RunFolder.at_work(config.out, about, config.overwrite, threads=1) as run,
        Console(config.quiet, len(units), "atlas") as console,
    ):
        _tell(run, console, settings.known)
        failed = _run(run, units, settings, config, console)
        sentences = publish(run)
        for sentence in sentences:
            console.result(sentence)
        console.result(
            f"{', '.join(config.encoders)}; seeds {told(seeds)}; report: {run.path / 'report.html'}"
        )
    return 1 if failed else 0


def _check(config: AtlasConfig) -> None:
    from encoders.frozen import ENCODERS
    from vidphys.probing.catalogue import TARGETS
    from vidphys.probing.readouts import ATTENTION, READOUTS, TWO_STAGE
    from vidphys.probing.two_stage import LEAST

    for name, least in (("each", 1), ("grid", 1), ("folds", 2), ("seeds", 1)):
        if getattr(config, name) < least:
            raise InputError(f"`{name}` {getattr(config, name)}: must be at least {least}")
    if config.seed < 0:
        raise InputError(f"`seed` {config.seed}: a seed is 0 or more")
    if not config.encoders:
        raise InputError("`encoders`: name at least one")
    if config.readout not in READOUTS:
        raise InputError(f"`readout` {config.readout}: use one of {', '.join(READOUTS)}")
    if config.readout == TWO_STAGE and config.each < LEAST:
        raise InputError(f"`each` {config.each}: `readout` two-stage reads {LEAST} frames at least")
    if config.readout != ATTENTION:
        refuse(config, ("widths", "rates"), f"`readout` {config.readout} is not trained")
    if min((*config.widths, *config.rates), default=1) <= 0:
        raise InputError("`widths` and `rates` must be above 0")
    for target in config.targets:
        TARGETS[target]
    for encoder in config.encoders:
        ENCODERS[encoder]
    prepare_device(config.device)
    config.check_workers()
    config.check_engine()


def _settings(config: AtlasConfig) -> AtlasSettings:
    """All that is asked, and what is known of the clips, which are opened for it."""
    from vidphys.probing.atlas import AtlasSettings
    from vidphys.probing.files import Files
    from vidphys.probing.trained import Attention

    clips = Files(
        config.data.resolve(),
        ClipSelection(config.start, config.stop, config.stride, config.side, config.rate),
        config.each,
        tuple(given_columns(config.columns).items()),
        config.resample,
        config.split_by,
    )
    known = clips.known(config.targets)
    known.require(config.folds, config.data)
    return AtlasSettings(
        clips=replace(clips),  # without the frames
        known=known,
        targets=config.targets,
        layers=config.layers,
        readout=config.readout,
        widths=config.widths or Attention.widths,
        rates=config.rates or Attention.rates,
        grid=config.grid,
        folds=config.folds,
        kept=config.kept,
        store=config.store.resolve(),
        weights=config.weights,
        device=config.device,
        hashes=clips.hashes,
    )


def _tell(run: RunFolder, console: Console, known: Known) -> None:
    """Say, and keep, what is asked, what is not, and what is odd about the clips."""
    targets = [labels.name for labels in known.labels]
    console.note(f"targets: {', '.join(targets)}")
    for line in known.told_left_out():
        console.note(f"left out: {line}")
    for note in known.told_notes():
        console.note(note)
    about = {"targets": targets, "left_out": dict(known.left_out)}
    run.tell(**about, clips=[dict(clip) for clip in known.about])


def _run(
    run: RunFolder,
    units: list[AtlasUnit],
    settings: AtlasSettings,
    config: AtlasConfig,
    console: Console,
) -> int:
    """Do every unit, where the options say; how many failed."""
    from vidphys.probing.atlas import run_unit
    from vidphys.runs.units import WorkUnit

    work = [WorkUnit({u.part: u.encoder}, u.encoder, (u, settings)) for u in units]
    return run_units(run, run_unit, work, config, console)


def publish(run: RunFolder) -> list[str]:
    """Join what was found, choose from it, and write ``atlas.json`` and the report.

    Returns:
        A sentence for each target.
    """
    from vidphys.probing.choice import places_of, told
    from vidphys.runs.records import read_table
    from vidphys.runs.sealed import write_sealed
    from viz.atlas import write_atlas

    records = run.join().to_pylist()
    episodes = read_table(run.path / "episodes.parquet").to_pylist()
    said = told(places_of(records, episodes))
    write_sealed(run.path / "atlas.json", said, SCHEMA)
    write_atlas(run.path)
    return [choice["sentence"] for choice in said["choices"]]
