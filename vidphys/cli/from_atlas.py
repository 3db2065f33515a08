"""``--from-atlas`` of ``train``: encoder, layer and readout that an atlas chose for positions."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vidphys.cli.atlas import SCHEMA
from vidphys.cli.options import refuse
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.cli.train import TrainConfig

TARGET = "position"
AUTO, REFINED = "auto", "refined"
# what reads, for `train`, the form of the map that a probe of the atlas did best on
READERS = {"cells": REFINED, "pooled": "pooled", "softmax": "attention", "attention": "attention"}


def with_atlas(config: TrainConfig) -> TrainConfig:
    """A configuration with the encoder and the layer that the atlas takes for positions.

    A readout that is not named becomes that of the form which was best there, else refined.

    Raises:
        InputError: not the folder of an atlas, one that was not asked for positions, or a layer or
            an encoder that is given as well.
    """
    if config.from_atlas is None:
        return replace(config, readout=_readout(config, REFINED))
    why = "the atlas chooses encoder and layer"
    refuse(config, ("layers",), why)
    if config.encoder != type(config).encoder:
        raise InputError(f"--encoder {config.encoder}: would have no effect: {why}; leave it away")
    choice = _choice(config.from_atlas)
    readout = _readout(config, READERS.get(choice["form"], REFINED))
    if not config.quiet:
        print(f"train: {choice['sentence']}; the readout is {readout}", file=sys.stderr)
    encoder, layer = str(choice["encoder"]), str(choice["layer"])
    return replace(config, encoder=encoder, layers=(layer,), readout=readout)


def _readout(config: TrainConfig, auto: str) -> str:
    return auto if config.readout == AUTO else config.readout


def _choice(run: Path) -> dict[str, Any]:
    """What the atlas says of positions."""
    from vidphys.runs.sealed import read_sealed

    path = run / "atlas.json"
    if not path.is_file():
        raise InputError(f"--from-atlas {run}: no atlas.json there; give a run of `vidphys atlas`")
    said = read_sealed(path, "an atlas", "run `vidphys atlas` again", SCHEMA, ("choices",))
    for choice in said["choices"]:
        if choice["target"] == TARGET:
            return dict(choice)
    raise InputError(
        f"--from-atlas {run}: it was not asked for {TARGET}; run `vidphys atlas` with it among "
        "--targets"
    )
