"""The verbs that write, each with its smallest command, in processes that can be stopped anywhere.

A process is forked from one that has imported everything, so that it starts at once. File
operations are told by Python's own audit events, whatever library asks for them; what compiled code
writes is seen when it is renamed into place.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.shared.serial import serially
from tests.shared.small_clips import know_cells, write_clip
from tests.shared.small_studies import TINY, with_short_lyapunov_times
from vidphys import presets
from vidphys.cli import main
from vidphys.runs import pool

CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.link", "os.symlink"}
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
QUICK = ("--steps", "4", "--head-steps", "2", "--shift", "1", "--readout", "attention")
CELLS = ("--encoder", "cells")
TABLE = ("--cells", "truth", "unstructured")  # one that learns, one that does not
ATLAS = ("--encoders", "cells", "--targets", "position", "--folds", "2", "--workers", "1")
RENDERED = ("--clips", "8", "--frames", "6", "--image", "32")  # what an atlas is made of
IMPORTED = (  # what verbs import late, and what takes long of it
    *("matplotlib.figure", "pandas", "pyarrow.csv", "pyarrow.parquet", "rerun.blueprint"),
    *("scipy.stats", "torch._dynamo", "encoders.frozen", "viz.atlas", "viz.recording"),
    *("viz.report", "viz.results", "viz.stress", "vidphys.diagnose.telling.answers"),
    *("vidphys.experiments.catalogue", "vidphys.probing.atlas", "vidphys.reading.training"),
    *("vidphys.stress.matrix", "vidphys.testing.encoders"),
    *(f"vidphys.cli.{verb}" for verb in ("fit", "ladder", "render", "reproduce", "rollout")),
    *(f"vidphys.cli.{verb}" for verb in ("atlas", "stress", "train", "view")),
)
ANYWHERE = ("extract", "view", "export", "report", "store")  # that hold no run's folder


def commands(made: Path, out: Path) -> dict[str, list[str]]:
    """Each verb's command line, of what :func:`prepared` made, into ``out``."""
    clips, told, to = made / "clips", made / "specification.json", ["--out", str(out / "run")]
    store = ["--store", str(out / "features"), *CELLS]
    table = str(made / "tracks.csv")
    quiet = {
        "render": ["render", "--clips", "2", "--frames", "4", "--image", "16", *to],
        "extract": ["extract", str(clips / "clip0.avi"), *CELLS, *to],
        "train": ["train", str(clips), *store, *QUICK, *to],
        "diagnose": ["diagnose", table, *to],
        "fit": ["fit", table, "--specification", str(told), "--steps", "4", *to],
        "rollout": ["rollout", str(made / "fit"), table, "--beyond", "0.5", *to],
        "ladder": ["ladder", "--cells", "oracle/unstructured", "--workers", "1", *to],
        "reproduce": ["reproduce", "inversion", *TABLE, "--seeds", "1", "--workers", "1", *to],
        "stress": ["stress", "--axes", "foreign", *to],
        "trade": ["trade", "--fronts", "drawing", *to],
        "film": ["film", "--clips", "1", *to],
        "atlas": ["atlas", str(made / "rendered"), *ATLAS, *store[:2], *to],
    }
    said = {
        "view": ["view", str(made / "fit"), "--save", str(out / "run" / "saved.rrd")],
        "export": ["export", str(made / "rollout"), *to],
        "report": ["report", str(made / "ladder"), str(made / "ladder"), *to],
        "store": ["store", "pack", str(out / "features")],
    }
    return {**{verb: [*asked, "--quiet"] for verb, asked in quiet.items()}, **said}


def laid(verb: str, made: Path, disk: Path) -> None:
    """Make the folder that a verb is to write below, with what it needs there."""
    disk.mkdir(parents=True)
    if verb == "store":
        shutil.copytree(made / "features", disk / "features")


def prepared(folder: Path, fitted: bool) -> Path:
    """Clips and a table, perhaps its specification and its fit too: what verbs are given."""
    made = folder / "made"
    for k in range(3):
        write_clip(made / "clips" / f"clip{k}.avi", 12, phase=k)
    times = np.arange(60) / 30
    x = 0.5 * np.cos(4 * times) + 1e-3 * np.random.default_rng(0).standard_normal(60)
    rows = "\n".join(f"{t:.6f},{x:.6f},0.0" for t, x in zip(times, x, strict=True))
    (made / "tracks.csv").write_text(f"t,x,y\n{rows}\n")
    if not fitted:
        return made
    ended(["diagnose", str(made / "tracks.csv"), "--out", str(made / "diagnosed"), "--quiet"])
    (made / "diagnosed" / "specification.json").replace(made / "specification.json")
    told = {"fit": "fit", "rollout": "rollout", "extract": "features", "ladder": "ladder"}
    for verb, name in told.items():
        ended(_into(commands(made, made)[verb], made / name))
    ended(["render", *RENDERED, "--out", str(made / "rendered"), "--quiet"])
    return made


def _into(asked: list[str], out: Path) -> list[str]:
    place = asked.index("--out") + 1
    return [*asked[:place], str(out), *asked[place + 1 :]]


def readied() -> None:
    """Import all that a verb would, once, and make studies small."""
    for name in IMPORTED:
        import_module(name)
    torch.set_num_threads(1)
    presets.PRESETS["quick"] = TINY
    pool.run_all = serially
    know_cells(pytest.MonkeyPatch())
    with_short_lyapunov_times(pytest.MonkeyPatch())


def forked(arguments: list[str], said: Path, before: Callable[[], None] | None = None) -> int:
    """A process that runs a verb; its number. What it says goes into a file."""
    child = os.fork()
    if child:
        return child
    code = 99
    try:
        heard = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(heard, 1)
        os.dup2(heard, 2)
        if before is not None:
            before()
        code = main(arguments)
    finally:
        os._exit(code)


def ended(arguments: list[str], before: Callable[[], None] | None = None) -> int:
    """Exit code of a verb in a process of its own; the signal, negative, that ended it."""
    said = Path(os.environ.get("TMPDIR", "/tmp")) / f"said-{os.getpid()}"
    return os.waitstatus_to_exitcode(os.waitpid(forked(arguments, said, before), 0)[1])


def at_operation(root: Path, number: int | None, do: int, count: Path) -> Callable[[], None]:
    """What makes a process send itself a signal before its n-th file operation below ``root``.

    Args:
        root: folder.
        number: of the operation, from 0; ``None`` lets it live.
        do: the signal.
        count: a file that is told the number of operations, one byte each.
    """

    def begin() -> None:
        told = os.open(count, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
        done = 0

        def hear(event: str, args: tuple) -> None:
            nonlocal done
            if event == "open":
                path, _, flags = args
                if not (isinstance(flags, int) and flags & WRITES):
                    return
            elif event in CHANGES:
                path = args[0]
            else:
                return
            if isinstance(path, bytes):
                path = os.fsdecode(path)
            relative = isinstance(path, str) and not path.startswith("/") and event != "open"
            if not relative and not str(path).startswith(str(root)):
                return
            if done == number:
                os.kill(os.getpid(), do)
            done += 1
            os.write(told, b".")

        sys.addaudithook(hear)

    return begin


@contextmanager
def stopped(arguments: list[str], root: Path, operation: int) -> Iterator[int]:
    """A process that stands still before its n-th file operation; killed at the end."""
    count = root.parent / "count-stopped"
    said = root.parent / "said-stopped"
    child = forked(arguments, said, at_operation(root, operation, signal.SIGSTOP, count))
    _, status = os.waitpid(child, os.WUNTRACED)
    try:
        yield child if os.WIFSTOPPED(status) else 0
    finally:
        if os.WIFSTOPPED(status):
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
