"""``vidphys film``: scenes of known physics as a phone films them, with the truth beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from vidphys.cli.console import Console


@dataclass(frozen=True)
class FilmConfig:
    """Film scenes of known physics as a phone sees them: a testbed for `vidphys diagnose`.

    Example: vidphys film --clips 200 --seed 0 --out filmed

    Pendulums, springs, tossed, bouncing and rolling balls, pucks, drag and hands, in rooms with
    textures and shadows. Every other clip is filmed well; the others have one trouble each: tilt,
    shake, lens, clutter, exposure, pan, blur, rolling shutter, compression or timing. Each clip has
    a folder with clip.mp4 and truth.json; index.json lists them.

    Args:
        out: the folder; the same command again goes on where it was, and more clips extend it.
        clips: how many are filmed.
        seed: of the set's random numbers; a clip depends on it and on its own number only.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    out: Path
    clips: int = 200
    seed: int = 0
    overwrite: bool = False
    quiet: bool = False


def film(config: FilmConfig) -> None:
    """See :class:`FilmConfig`.

    Raises:
        InputError: no clip, another run in the folder, or nothing here that draws or encodes.
    """
    from vidphys.experiments.filmed.folder import film_folder
    from vidphys.runs.folder import RunFolder

    about = {"experiment": "film", "cells": [], "seeds": [], "seed": config.seed}
    with (
        RunFolder.at_work(config.out, about, config.overwrite) as run,
        Console(config.quiet, 1, "film") as console,
    ):

        def show(done: int, _clips: int, _: float) -> None:
            console.stage(("clips", done, config.clips))

        index = film_folder(run.path, config.seed, config.clips, show)
        console.done(0)
        console.result(f"{config.clips} clips: {index}")
