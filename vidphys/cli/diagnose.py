"""``vidphys diagnose``: which terms a scene requires, from tracks or a clip, and what is open."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from vidphys.cli.console import Console
from vidphys.cli.given import check, load, told_in
from vidphys.cli.options import MOTION, given_columns, make_binder
from vidphys.cli.profiles import with_profile
from vidphys.cli.who import WhoOptions
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.cli.drawing import Drawer, Drawing
    from vidphys.data.frames import Frames
    from vidphys.diagnose.recordings.tables import Loaded
    from vidphys.diagnose.telling.answered import Answered
    from vidphys.points.point import Point
    from vidphys.runs.folder import RunFolder
    from vidphys.runs.records import Recorder

SCHEMA_VERSION = 2  # of diagnosis.json; 1 had no seal
WRITTEN = (
    "summary.txt",
    "report.html",
    "diagnosis.json",
    "specification.json",
    "tracks.csv",
    "figures/diagnosis.svg",
    "recordings/diagnosis.rrd",
)
ELSEWHERE = ("out", "look", "video", "profile", "overwrite", "quiet", "input", "trade")


@dataclass(frozen=True)
class DiagnoseConfig(WhoOptions):
    """Find which terms a scene requires, from recorded tracks or from a clip.

    Example: vidphys diagnose tracks.csv --out runs/diagnosis

    Writes a report, a summary, diagnosis.json, specification.json (from which `vidphys fit` trains
    exactly that model), the tracks of a clip, a figure and a recording for `vidphys view`.

    Args:
        input: a table of times and positions (numbers between commas, semicolons, tabs or blanks;
            workbooks, Parquet, NPZ, MATLAB, JSON; a project of Tracker; COCO's boxes), or a clip
            whose moving bodies a hand-made binder follows; that of a data set is named as if the
            set were a folder (runs.h5/trial).
        out: the run folder.
        columns: what columns of a table are, where their names do not tell (x1=LEFT time[ms]=T), or
            which of its bodies are looked at (x=x2 y=y2); input=M is a known push, like a torque.
        interval: seconds between frames, where the table has no times.
        angles: the coordinates are joint angles in radians; told by names like theta otherwise.
        hold_out: share of one long recording, at its end, that nothing is fitted to and the
            forecast is scored on.
        binder: what follows the bodies of a clip: motion, or package.module:name.
        bodies: how many it follows; unless given, as many as move by some law.
        shadow: darkening, as a factor of the background's brightness, that motion takes for a
            shadow rather than a body; 1 keeps every change. Found out unless given.
        start: first frame that is used.
        stop: frame to stop before.
        rate: frames per second of a clip, in place of the container's time stamps.
        scale: a length that is known in a clip's picture, and the pixels between which it lies
            ("0.30 m = 10,200 310,200"): numbers are told in its unit. Or the sides of a rectangle
            in the plane that bodies move in, and its corners in order round it ("2.2 x 1.1 m =
            80,60 550,70 600,400 30,380"): that plane may be seen from anywhere.
        gravity: m/s² of what hangs or falls freely (9.81): such a body is a ruler, and numbers are
            told in metres.
        trade: what `vidphys trade` has measured, its run folder or profile: which integrator and
            which encoder suffice is chosen from it.
        profile: settings for this verb, from a file that `vidphys trade --pick ... --save` wrote.
        look: only draw what may be a body, numbered, into look.png in the run folder; one of them
            is then followed with --choose.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
        video: also draw the track, the forecast and a changed law over the clip's frames, into
            this .mp4 file; where no law foretells, that the bodies stay.
    """

    input: Annotated[Path, tyro.conf.Positional]
    out: Path = Path("runs/diagnosis")
    columns: tuple[str, ...] = ()
    interval: float | None = None
    angles: bool = False
    hold_out: float = 0.3
    binder: str | None = None
    bodies: int | None = None
    shadow: float | None = None
    start: int = 0
    stop: int | None = None
    rate: float | None = None
    scale: str | None = None
    gravity: float | None = None
    trade: Path | None = None
    profile: Path | None = None
    look: bool = False
    overwrite: bool = False
    quiet: bool = False
    video: Path | None = None


def diagnose(config: DiagnoseConfig) -> None:
    """See :class:`DiagnoseConfig`.

    Raises:
        InputError: an input that cannot be read or is too short, options that make no sense, or
            another run in the folder.
    """
    if not 0 <= config.hold_out < 1:
        raise InputError(f"--hold-out {config.hold_out}: must be at least 0 and below 1")
    if config.gravity is not None and not config.gravity > 0:
        raise InputError(f"--gravity {config.gravity}: must be above 0")
    if config.scale is not None:
        told_in(config, (1, 1))
    given = given_columns(config.columns)
    from vidphys.data.sets import only_clip

    config = replace(config, input=only_clip(config.input))
    check(config)
    config = with_profile(config, "diagnose")
    if config.look:
        _look(config)
        return
    from vidphys.cli.drawing import Drawer
    from vidphys.data.dataset import is_clip

    with Drawer(aside=not is_clip(config.input)) as drawer:  # pictures are seldom handed over
        _diagnose(config, given, drawer)


def _diagnose(config: DiagnoseConfig, given: dict[str, str], drawer: Drawer) -> None:
    from vidphys.cli.drawing import drawing_of
    from vidphys.runs.folder import RunFolder
    from viz.told import write_told

    points = [] if config.trade is None else _measured(config.trade)
    # one unit, so that what cannot be read is told in a line with none before it
    looking = Console(config.quiet, 1, "diagnose")
    with looking, looking.busy(f"looking at {config.input.name}"):
        loaded, frames = load(config, given)
    about = {**_about(config), "trade": sorted(point.key for point in points)}
    threads = 0 if frames is None else None  # of torch, which takes a second to load
    with (
        RunFolder.at_work(config.out, about, config.overwrite, threads) as run,
        Console(config.quiet, 2, "diagnose") as console,
    ):
        try:
            with console.busy("the search for the law"):
                found = _answer(config, loaded, frames, points, console)
        except ValueError as error:
            run.abandon()
            raise InputError(f"{config.input}: {error}") from error
        console.done(0)
        _clear(run)
        drawn = drawer.begin(lambda: drawing_of(run.path, config.input.name, found, frames))
        _keep(run, config, loaded, found)
        with console.drawing("the diagnosis"):
            _film(drawn(), config, found, frames)
        with console.drawing("the report"):
            write_told(run.path)
        console.done(1)
        for line in (*loaded.notes, *found.lines):
            console.result(line)
        summary, *others = (name for name in WRITTEN if (run.path / name).exists())
        console.result(f"written: {run.path / summary}, {', '.join(others)}")
        if config.video is not None:
            console.result(f"film: {config.video}")


def _answer(
    config: DiagnoseConfig,
    loaded: Loaded,
    frames: Frames | None,
    points: list[Point],
    console: Console,
) -> Answered:
    from vidphys.diagnose.telling.answers import answer

    return answer(
        loaded.motion,
        loaded.angles or config.angles,
        config.hold_out,
        points,
        frames is not None,
        replace(loaded.units, gravity=config.gravity),
        loaded.used,
        lambda step, steps, _: console.stage(("formula", step, steps)),
    )


def _look(config: DiagnoseConfig) -> None:
    from vidphys.cli.look import look
    from vidphys.data.video import ClipSelection

    binder = make_binder(config.binder, config.bodies, config.shadow, config, count=True)
    selection = ClipSelection(config.start, config.stop, rate=config.rate)
    with Console(config.quiet, 1, "look") as console:
        lines = look(config.input, selection, binder, config.out)
        console.done(0)
        for line in lines:
            console.result(line)


def _measured(folder: Path) -> list[Point]:
    from vidphys.trade.session import load_points

    if not folder.exists():
        raise InputError(
            f"--trade {folder}: nothing was measured there; `vidphys trade --out {folder}` does"
        )
    return load_points(folder)


def _about(config: DiagnoseConfig) -> dict[str, Any]:
    from vidphys.data.dataset import content_sha256
    from vidphys.data.formats import sources_of

    given = {key: value for key, value in asdict(config).items() if key not in ELSEWHERE}
    return {
        **given,
        "experiment": "diagnose",
        "cells": ["diagnosis"],
        "seeds": [0],
        "input": config.input.name,
        "input_sha256": content_sha256(config.input),
        "sources": sources_of(config.input),
    }


def _clear(run: RunFolder) -> None:
    """Of an earlier answer, which perhaps had more to say."""
    for name in WRITTEN:
        (run.path / name).unlink(missing_ok=True)


def _keep(run: RunFolder, config: DiagnoseConfig, loaded: Loaded, found: Answered) -> None:
    from vidphys.data.dataset import is_clip
    from vidphys.diagnose.recordings.tables import write_tracks
    from vidphys.runs.atomic import write_json, write_with
    from vidphys.runs.sealed import write_sealed

    text = "\n".join((*loaded.notes, *found.lines)) + "\n"
    write_with(run.path / "summary.txt", lambda path: path.write_text(text, encoding="utf-8"))
    write_sealed(run.path / "diagnosis.json", found.data, SCHEMA_VERSION)
    if found.specification is not None:
        write_json(run.path / "specification.json", found.specification)
    if is_clip(config.input):
        write_with(run.path / "tracks.csv", lambda path: write_tracks(path, loaded.motion))
    run.finish("diagnosis", *_record(config, found).tables())
    run.join()


def _record(config: DiagnoseConfig, found: Answered) -> Recorder:
    from vidphys.data.dataset import is_clip
    from vidphys.runs.records import Origin, Recorder

    origin = Origin(
        experiment="diagnose",
        cell="diagnosis",
        system=config.input.name,
        grounding="tracks",
        encoder="none",
        binder=config.binder or MOTION if is_clip(config.input) else "none",
        readout="none",
        head="diagnosed",
        seed=0,
        device="cpu",
        dtype="float64",
    )
    recorder = Recorder(origin)
    for metric, value in found.numbers.items():
        recorder.add_value(metric, value)
    return recorder


def _film(drawing: Drawing, config: DiagnoseConfig, found: Answered, frames: Frames | None) -> None:
    """The clip with what was foretold drawn over it, where that is asked for."""
    from vidphys.cli.drawing import STAYS
    from vidphys.cli.recordings import draw_film, followed_alone

    if config.video is not None and frames is not None:
        alone = found.shown(found.positions)
        shown = drawing.arrays or followed_alone(found.times, alone, frames)
        draw_film(shown, config.video, found.law, STAYS if found.stays else "forecast")
