"""``--from-atlas RUN`` of ``train``: the encoder and layer that an atlas chose for positions."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vidphys.cli.atlas import SCHEMA
from vidphys.cli.options import refuse
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.cli.train import TrainConfig

TARGET = "position"


def with_atlas(config: TrainConfig) -> TrainConfig:
    """A configuration with the encoder and the layer that the atlas takes for positions.

    Raises:
        InputError: not the folder of an atlas, one that was not asked for positions, or a layer or
            an encoder that is given as well.
    """
    if config.from_atlas is None:
        return config
    why = "the atlas chooses encoder and layer"
    refuse(config, ("layers",), why)
    if config.encoder != type(config).encoder:
        raise InputError(f"--encoder {config.encoder}: would have no effect: {why}; leave it away")
    encoder, layer, sentence = _choice(config.from_atlas)
    if not config.quiet:
        print(f"train: {sentence}", file=sys.stderr)
    return replace(config, encoder=encoder, layers=(layer,))


def _choice(run: Path) -> tuple[str, str, str]:
    """Encoder, layer, and the sentence that says why."""
    from vidphys.runs.sealed import read_sealed

    path = run / "atlas.json"
    if not path.is_file():
        raise InputError(f"--from-atlas {run}: no atlas.json there; give a run of `vidphys atlas`")
    said = read_sealed(path, "an atlas", "run `vidphys atlas` again", SCHEMA, ("choices",))
    for choice in said["choices"]:
        if choice["target"] == TARGET:
            return str(choice["encoder"]), str(choice["layer"]), str(choice["sentence"])
    raise InputError(
        f"--from-atlas {run}: it was not asked for {TARGET}; run `vidphys atlas` with it among "
        "--targets"
    )
