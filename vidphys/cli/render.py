"""``vidphys render``: clips of a scene, with the truth beside them, into a folder."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from vidphys.cli.console import Console
from vidphys.cli.profiles import with_profile


@dataclass(frozen=True)
class RenderConfig:
    """Render clips of a scene, with its truth beside them, to look at or train on.

    The truth of each clip is a table: states, momenta, the derivatives of both, and the law's
    numbers. Derivatives hold friction and drive, not the noise of a bath; dataset.json says so.

    Example: vidphys render --out clips --scene gravity --world rgb --clips 64

    Args:
        out: the folder; the same command again goes on where it was.
        scene: the law and its generator; `vidphys parts` names them, and package.module:factory is
            one too.
        world: a channel for each body, coloured disks that hide one another, or bodies that look
            alike.
        preset: how many clips, how long and how large.
        clips: how many, in place of the preset's number.
        frames: how many a clip has, in place of the preset's number.
        image: pixels on a side, in place of the preset's.
        seed: of the random numbers that episodes are drawn by.
        profile: settings for this verb, from a file that `vidphys trade --pick ... --save` wrote.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    out: Path
    scene: str = "gravity"
    world: Literal["rgb", "channels", "anonymous"] = "rgb"
    preset: Literal["quick", "standard", "paper"] = "quick"
    clips: int | None = None
    frames: int | None = None
    image: int | None = None
    seed: int = 0
    profile: Path | None = None
    overwrite: bool = False
    quiet: bool = False


def render(config: RenderConfig) -> None:
    """See :class:`RenderConfig`.

    Raises:
        InputError: sizes that make no sense, or another run in the folder.
    """
    config = with_profile(config, "render")
    from vidphys.data.rendered import RenderSettings, render_folder
    from vidphys.presets import preset
    from vidphys.runs.folder import RunFolder
    from vidphys.scenes import SCENES
    from vidphys.scenes.gravity import DT

    sizes = preset(config.preset).pixel
    settings = RenderSettings(
        config.scene,
        config.world,
        sizes.clips if config.clips is None else config.clips,
        sizes.frames if config.frames is None else config.frames,
        max(1, round(sizes.stride * DT / SCENES[config.scene]().dt)),  # as many seconds in each
        sizes.image if config.image is None else config.image,
        config.seed,
    )
    about = {"experiment": "render", "cells": [], "seeds": [], **asdict(settings)}
    about["sources"] = SCENES.sources(config.scene)
    with (
        RunFolder.at_work(config.out, about, config.overwrite) as run,
        Console(config.quiet, 1, "render") as console,
    ):

        def show(done: int, _clips: int, _: float) -> None:
            console.stage(("clips", done, settings.clips))

        manifest = render_folder(run, settings, show)
        console.done(0)
        console.result(f"{settings.clips} clips of {settings.frames} frames: {manifest}")
