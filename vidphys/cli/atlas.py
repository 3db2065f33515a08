"""``vidphys atlas``: what each layer of frozen encoders knows of each target, beside controls."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.options import refuse
from vidphys.data.video import ClipSelection
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.probing.atlas import AtlasSettings, AtlasUnit
    from vidphys.runs.folder import RunFolder

SCHEMA = 1  # of atlas.json


@dataclass(frozen=True)
class AtlasConfig:
    """Map what each layer of frozen encoders knows of each target, beside all controls.

    Example: vidphys atlas clips --encoders dino-tiny vjepa2-tiny --out runs/atlas

    The report shows a heat map, cost beside accuracy, and for each target which encoder to take at
    which layer. More encoders on the same command add rows; interrupted, it goes on where it was.

    Args:
        data: a folder of `vidphys render`, or of clips with a table (CSV or Parquet) beside each.
        out: the run folder.
        encoders: frozen encoders, by a name of `vidphys parts`, timm:NAME, hf:FOLDER or
            package.module:factory; each is read at all its layers.
        targets: position, velocity, speed, direction, acceleration, force, momentum, mass, charge,
            coupling, contact, count, or column:, angle: (radians) or class: and the name of a
            column; all that the tables tell if none is named.
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
        workers: how many processes share the work.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    data: Annotated[Path, tyro.conf.Positional]
    out: Path = Path("runs/atlas")
    encoders: tuple[str, ...] = ("dino-tiny", "videomae-tiny", "vjepa2-tiny")
    targets: tuple[str, ...] = ()
    readout: str = "linear"
    widths: tuple[int, ...] = ()
    rates: tuple[float, ...] = ()
    each: int = 2
    grid: int = 8
    folds: int = 5
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
    workers: int = 2
    overwrite: bool = False
    quiet: bool = False


def atlas(config: AtlasConfig) -> int:
    """Do what is left of the atlas, then write its tables, choices and report.

    Returns:
        0, or 1 if an encoder failed; what others found is kept.

    Raises:
        InputError: clips or tables that cannot be read, an unknown name, options that make no
            sense, or another run in the folder.
    """
    from vidphys.probing.atlas import AtlasUnit, settings_of
    from vidphys.runs.folder import RunFolder
    from vidphys.seeding import told

    settings = _settings(config)
    seeds = range(config.seed, config.seed + config.seeds)
    about = settings_of(settings, config.encoders, seeds)
    units = [AtlasUnit(name, seed) for seed in seeds for name in config.encoders]
    with (
        RunFolder.at_work(config.out, about, config.overwrite, threads=1) as run,
        Console(config.quiet, len(units), "atlas") as console,
    ):
        failed = _run_units(run, units, settings, config.workers, console)
        sentences = publish(run)
        for sentence in sentences:
            console.result(sentence)
        console.result(
            f"{len(config.encoders)} encoders, seeds {told(seeds)}; report: "
            f"{run.path / 'report.html'}"
        )
    return 1 if failed else 0


def _settings(config: AtlasConfig) -> AtlasSettings:
    from vidphys.data.dataset import find_dataset
    from vidphys.probing.atlas import AtlasSettings
    from vidphys.probing.catalogue import TARGETS
    from vidphys.probing.readouts import ATTENTION, READOUTS, TWO_STAGE
    from vidphys.probing.trained import Attention
    from vidphys.probing.two_stage import LEAST

    for name, least in (("each", 1), ("grid", 1), ("folds", 2), ("seeds", 1), ("workers", 1)):
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
    dataset = find_dataset(config.data)
    if len(dataset.files) < 2 * config.folds:
        raise InputError(
            f"{config.data}: {len(dataset.files)} clips; `folds` {config.folds} needs at least "
            f"{2 * config.folds}"
        )
    return AtlasSettings(
        data=config.data.resolve(),
        selection=ClipSelection(config.start, config.stop, config.stride, config.side, config.rate),
        targets=config.targets,
        readout=config.readout,
        widths=config.widths or Attention.widths,
        rates=config.rates or Attention.rates,
        each=config.each,
        grid=config.grid,
        folds=config.folds,
        kept=config.kept,
        store=config.store.resolve(),
        weights=config.weights,
        hashes=tuple(dataset.hashes[name] for name in sorted(dataset.hashes)),
    )


def _run_units(
    run: RunFolder,
    units: list[AtlasUnit],
    settings: AtlasSettings,
    workers: int,
    console: Console,
) -> int:
    """Do every unit; one that fails is named in the run folder and the others go on.

    Returns:
        How many failed. An encoder whose weights are not on this machine is skipped, which is no
        failure.
    """
    from encoders.release import WeightsMissing
    from vidphys.probing.atlas import run_unit
    from vidphys.runs.pool import run_all

    failed, lost = 0, set()
    tasks = [(run.path, unit, settings) for unit in units]
    for index, error in run_all(run_unit, tasks, workers, console.stage, console.done):
        absent = isinstance(error, WeightsMissing)
        failed += not absent
        word = "skipped" if absent else f"failed: {type(error).__name__}"
        lost.add(units[index].encoder)
        run.skip(units[index].encoder, f"{word}: {error}")
        console.warn(f"{units[index].part} {word}: {error}")
    run.unskip({unit.encoder for unit in units} - lost)
    return failed


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
