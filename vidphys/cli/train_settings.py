"""The settings of a training: its options, once they are known to make sense."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vidphys.cli.options import option, refuse
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.cli.train import TrainConfig
    from vidphys.reading.training import TrainSettings

HEADS = 4  # by which the width of a readout's attention is divided
SIZES = {"widths": "width", "readers": "readers"}  # option: what a kind of readout calls it


def check(config: TrainConfig) -> None:
    """Whether the readout is known and takes the options, and numbers are where they must be.

    Raises:
        InputError: it is not, or they are not.
    """
    from readouts.kinds import READOUTS, ReadoutKind

    try:
        kind = READOUTS[config.readout]
    except ValueError as error:
        raise InputError(f"--readout {config.readout}: {error}") from error
    if not isinstance(kind, ReadoutKind):
        raise InputError(f"--readout {config.readout}: must be a ReadoutKind, is {kind!r}")
    why = f"--readout {config.readout} takes none"
    refuse(config, [option for option, size in SIZES.items() if size not in kind.sizes], why)
    refuse(config, ("shift",) if kind.shift is None else (), why)
    counts = ("seeds", "steps", "batch", "head_steps", "readers", "widths")
    for name, least in (*((name, 1) for name in counts), ("patience", 0), ("shift", 0)):
        given = getattr(config, name)
        for value in given if isinstance(given, tuple) else (given,):
            if value is not None and value < least:
                raise InputError(f"{option(name)} {value}: must be at least {least}")
    for width in config.widths if config.readout == "attention" else ():
        if width % HEADS:
            raise InputError(f"--widths {width}: must be a multiple of {HEADS}")
    for rate in config.learning_rates:
        if not 0 < rate < float("inf"):
            raise InputError(f"--learning-rates {rate}: must be above 0")
    if not config.learning_rates:
        raise InputError("--learning-rates: name at least one")
    if not config.beyond >= 0:
        raise InputError(f"--beyond {config.beyond}: must be at least 0 seconds")


def settings_of(config: TrainConfig) -> TrainSettings:
    """What the options say; where they say nothing, what the kind of readout does."""
    from readouts.kinds import READOUTS
    from vidphys.reading.training import TrainSettings
    from vidphys.training.candidates import Grid
    from vidphys.training.early_stopping import StopSettings
    from vidphys.training.learner import FitSettings
    from vidphys.training.readouts import ReadoutSettings

    kind = READOUTS[config.readout]
    steps, batch = config.steps or kind.steps, config.batch or kind.batch
    shift = (kind.shift or 0) if config.shift is None else config.shift
    fit = FitSettings(steps, batch, config.learning_rates[0], kind.clip, on_nan=config.on_nan)
    readout = ReadoutSettings(fit, shift, StopSettings(patience=config.patience))
    seeds = tuple(range(config.seed, config.seed + config.seeds))
    sizes = {size: getattr(config, option) for option, size in SIZES.items()}
    tried = {size: values for size, values in sizes.items() if values}
    grid = Grid(config.readout, tried, config.learning_rates, seeds)
    how = config.mirrors, config.selection, config.train_share, config.head_steps
    return TrainSettings(
        readout,
        grid,
        *how,
        config.heads,
        config.seed,
        config.on_nan,
        config.device,
        split_by=config.split_by,
        store_dtype=config.store_dtype,
    )
