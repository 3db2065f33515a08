"""``vidphys view``: look at a run's recordings in the rerun viewer."""

from __future__ import annotations

import difflib
import json
import shutil
import socket
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from filecmp import cmp
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tyro

from vidphys.errors import InputError

PREFERRED = ("renderer/factored", "oracle/factored")  # of many cells, which is shown at first


@dataclass(frozen=True)
class ViewConfig:
    """Look at a run's recordings in the rerun viewer.

    Example: vidphys view runs/ladder --cell oracle/factored --web

    Args:
        run: the run's folder, or a recording (.rrd).
        cell: cells to show (grounding/head), or `all`; one if none is named, and all are saved.
        seeds: show one cell's model of every seed side by side, rolled from one start.
        web: serve the viewer to a browser, on this machine only.
        save: write the recordings to this .rrd file, or into this folder, which the same command
            goes on filling, instead of showing them.
        movie: write one cell's episode as a film of eight seconds (.mp4 or .gif), or its last
            picture (.png), instead of showing it.
    """

    run: Annotated[Path, tyro.conf.Positional]
    cell: tuple[str, ...] = ()
    seeds: bool = False
    web: bool = False
    save: Path | None = None
    movie: Path | None = None


def view(config: ViewConfig) -> None:
    """Show, serve or save the recordings of a run.

    Args:
        config: what to show, and where.

    Raises:
        InputError: there is no such run, recording or cell, no display to show them on, or
            ``save`` exists.
    """
    from viz import viewer

    if sum((config.web, config.save is not None, config.movie is not None)) > 1:
        raise InputError("view: --web, --save and --movie exclude each other; give one of them")
    if config.seeds and config.movie is not None:
        raise InputError("view: --movie shows one model, --seeds several; give one of them")
    if config.movie is not None:
        _film(config, config.movie)
        return
    chosen = {"": config.run} if config.run.suffix == ".rrd" else _choose(config)
    if config.save is None and not config.web and not viewer.has_display():
        raise InputError(
            "view: there is no display here; use --web to look in a browser, or --save PATH to "
            "take the recordings to another machine"
        )
    if config.save is not None and config.save.suffix and _is_taken(config.save):
        raise InputError(f"view: --save {config.save} exists; remove it or choose another path")
    folder = config.run.parent if config.run.suffix == ".rrd" else config.run
    with TemporaryDirectory() as drawn:
        if config.seeds:
            recordings = [_seeds(config.run, chosen, Path(drawn))]
        else:
            recordings = [_recording(folder, file) for file in chosen.values()]
        if config.save is not None:
            _save(recordings, config.save)
        elif config.web:
            _serve(folder, chosen, recordings)
        else:
            viewer.open_window(recordings)


def _seeds(run: Path, chosen: Mapping[str, Path], folder: Path) -> Path:
    """The recording of one cell's seeds, under the cell's name."""
    from vidphys.cli.seeds import write_seeds

    if len(chosen) != 1 or "" in chosen:
        raise InputError("view: --seeds shows one cell of a ladder; choose it by --cell NAME")
    ((cell, file),) = chosen.items()
    path = folder / f"{file.stem}.rrd"
    write_seeds(run, cell, path)
    return path


def _film(config: ViewConfig, target: Path) -> None:
    """One cell's episode as a film; a diagnosis and a rollout draw theirs by ``--video``."""
    from viz.movie import write_movie
    from viz.showcase import read_showcase

    if _is_taken(target):
        raise InputError(f"view: --movie {target} exists; remove it or choose another path")
    name, file = next(iter(_choose(config).items()))
    source = config.run / "showcase" / f"{file.stem}.safetensors"
    if not source.is_file():
        raise InputError(
            f"view: --movie draws a cell of a ladder, and {config.run} has no showcase of {name}; "
            "`vidphys diagnose` and `vidphys rollout` draw theirs over a clip by --video"
        )
    try:
        arrays, meta = read_showcase(source)
        write_movie(arrays, {**meta, "cell": name}, target)
    except ValueError as error:
        raise InputError(f"view: --movie: {error}") from error
    print(f"wrote {target}: {name}")


def _choose(config: ViewConfig) -> dict[str, Path]:
    """The cells to show, each with its file."""
    from vidphys.runs.recordings import recordings_of

    if not config.run.is_dir():
        raise InputError(
            f"view: {config.run} is not a folder; give the folder of a run, or a .rrd file"
        )
    cells = recordings_of(config.run)
    if not cells:
        raise InputError(
            f"view: {config.run} has no recordings; give the folder of a finished run "
            "(recordings/*.rrd or showcase/*.safetensors)"
        )
    if config.cell == ("all",) or (not config.cell and config.save is not None):
        return cells
    if not config.cell:
        first = next((name for name in PREFERRED if name in cells), next(iter(cells)))
        others = [name for name in cells if name != first]
        if others:
            print(f"shown: {first}; by --cell NAME, or --cell all: {', '.join(others)}")
        return {first: cells[first]}
    chosen = {}
    for name in config.cell:
        dashed = name.replace("/", "-")  # so in a run that was stopped
        name = dashed if dashed in cells else name
        if name not in cells:
            why = _skipped(config.run, name)
            if why:
                raise InputError(f"view: --cell {name} has no recording: {why}")
            near = difflib.get_close_matches(name, cells, n=1)
            guess = f"did you mean {near[0]}? " if near else ""
            raise InputError(
                f"view: --cell {name} is not in {config.run}; {guess}there are {', '.join(cells)}"
            )
        chosen[name] = cells[name]
    return chosen


def _skipped(run: Path, cell: str) -> str | None:
    """Why a cell was not run, as the run's ``run.json`` says it."""
    try:
        entries = json.loads((run / "run.json").read_text(encoding="utf-8"))["skipped"]
    except (OSError, ValueError, KeyError):
        return None
    reasons = {str(e.get("cell")): str(e.get("reason")) for e in entries}
    return reasons.get(cell, reasons.get(f"ladder/{cell}"))


def _recording(run: Path, file: Path) -> Path:
    """A recording's file, written if there is only its showcase.

    Raises:
        InputError: it leads out of the run, or cannot be read.
    """
    if not file.resolve().is_relative_to(run.resolve()):
        raise InputError(f"view: {file} is a link that leads out of the run; copy its file there")
    if file.suffix == ".rrd":
        return file
    from viz.recording import write_recording
    from viz.showcase import read_showcase
    from viz.story import story

    path = run / "recordings" / f"{file.stem}.rrd"
    try:
        showcase, about = read_showcase(file)
    except ValueError as error:
        raise InputError(f"view: {error}") from error
    write_recording(showcase, story(run, about), path)
    return path


def _save(recordings: list[Path], target: Path) -> None:
    """Into one file if ``target`` ends in .rrd, else one file each into that folder."""
    from viz import viewer
    from viz.whole import whole

    if target.suffix == ".rrd":
        viewer.merge(recordings, target)
        print(f"wrote {target}: {len(recordings)} recording(s)")
        return
    if target.suffix or target.is_file():
        raise InputError(f"view: --save {target} is neither a .rrd file nor a folder; name one")
    places = {target / recording.name: recording for recording in recordings}
    there = [place for place in places if _is_taken(place)]
    for place in there:  # as the same command, stopped before its end, leaves it
        if place.is_symlink() or not place.is_file() or not cmp(place, places[place], False):
            raise InputError(f"view: --save would overwrite {place}; choose another folder")
    target.mkdir(parents=True, exist_ok=True)
    for place in places.keys() - there:
        with whole(place) as part:
            shutil.copyfile(places[place], part)
    more = f"; {len(there)} lay there" if there else ""
    print(f"wrote {len(places) - len(there)} recording(s) into {target}{more}")


def _is_taken(path: Path) -> bool:
    """Whether something has this name, be it a link that leads nowhere."""
    return path.exists() or path.is_symlink()


def _serve(run: Path, chosen: Mapping[str, Path], recordings: list[Path]) -> None:
    from viz import viewer
    from viz.poster import poster
    from viz.served import serving

    port = viewer.free_port(viewer.WEB_PORT)
    forward = f"ssh -N -L {port}:127.0.0.1:{port} {socket.gethostname()}"
    told = poster(run, next(iter(chosen.values())))
    with serving(recordings, viewer.web_code(), told, port) as address:
        print(f"open      {address}")
        print(f"from elsewhere, first run there: {forward}")
        print("Ctrl-C ends it")
        sys.stdout.flush()
        with suppress(KeyboardInterrupt):  # it is the way to end it
            wait()


def wait() -> None:
    """Until interrupted."""
    threading.Event().wait()
