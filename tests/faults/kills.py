"""Verbs that are killed before each of their file operations, or at random instants, and go on.

``python -m tests.faults.kills FOLDER [VERB …]`` prints a line of JSON for each verb: how many kills
locked the same command out, or led to other bits. ``--points`` are so many of its operations
in place of all, ``--instants`` so many random moments besides. ``--pairs`` lets each into the
folder of another that stands still, with and without ``--overwrite``, and tells what changed
of the first.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import threading
import time
from pathlib import Path

import numpy as np

from tests.faults.remains import Remains, differing, left, shared
from tests.faults.verbs import (
    ANYWHERE,
    at_operation,
    commands,
    ended,
    forked,
    laid,
    prepared,
    readied,
    stopped,
)

STANDS = {"view": 1, "export": 1}  # operations of a verb into its work, at which it stands still
USUAL = 3  # of all others
REFUSED = 2  # rightly where all is there already: some write nothing over what is there
TOLD = 1.0  # seconds, as times are told: what tells one must differ between two runs
INSTANTS = 13  # random ones of each verb: 200 of all


def undisturbed(verb: str, made: Path, folder: Path) -> tuple[Remains, int, float]:
    """What it leaves however often it is run, its file operations and its seconds."""
    disk, count, runs = folder / "disk", folder / "count", []
    for _ in range(2):
        time.sleep(TOLD)
        began = time.monotonic()
        laid(verb, made, disk)
        code = ended(commands(made, disk)[verb], at_operation(disk, None, 0, count))
        seconds = time.monotonic() - began
        assert code in (0, 1), (verb, code)
        runs.append(left(disk))
        shutil.rmtree(disk)
    return shared(*runs), count.stat().st_size, seconds


def kills(
    verb: str, made: Path, folder: Path, points: int | None, instants: int
) -> dict[str, object]:
    whole, operations, seconds = undisturbed(verb, made, folder)
    chosen = range(operations)
    if points is not None:
        chosen = sorted({int(n) for n in np.linspace(0, operations - 1, points)})
    steady = sum(value is not None for value in whole.values())
    found = {"verb": verb, "operations": operations, "files": len(whole), "compared": steady}
    found |= {"kills": 0, "locked out": [], "differ": []}
    disk = folder / "disk"
    moments = np.random.default_rng(0).uniform(0, seconds, instants)
    for point in [*chosen, *(float(moment) for moment in moments)]:
        laid(verb, made, disk)
        arguments = commands(made, disk)[verb]
        if isinstance(point, float):
            found["kills"] += killed_after(arguments, folder, point)
        else:
            hook = at_operation(disk, point, signal.SIGKILL, folder / "count")
            found["kills"] += ended(arguments, hook) == -signal.SIGKILL
        aged(disk)
        code, wrong = ended(arguments), differing(disk, whole)
        if code not in ((0, 1) if wrong else (0, 1, REFUSED)):
            found["locked out"].append([point, code])
        elif wrong:
            found["differ"].append([point, wrong])
        shutil.rmtree(disk)
    return found


def aged(disk: Path) -> None:
    """As if the kill were long ago: what nobody goes on writing is then swept."""
    for path in disk.rglob(".*.partial*"):
        os.utime(path, (0, 0))


def killed_after(arguments: list[str], folder: Path, seconds: float) -> bool:
    child = forked(arguments, folder / "said")
    timer = threading.Timer(seconds, os.kill, (child, signal.SIGKILL))
    timer.start()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    timer.cancel()
    return code == -signal.SIGKILL


def files(disk: Path) -> dict[str, bytes]:
    found = (path for path in disk.rglob("*") if path.is_file())
    return {str(path.relative_to(disk)): path.read_bytes() for path in found}


def pairs(first: str, seconds: list[str], made: Path, folder: Path) -> dict[str, object]:
    """Of a verb that stands still in the middle of its work, what others change."""
    disk = folder / "disk"
    laid(first, made, disk)
    found = {"first": first, "tried": 0, "stood": 0, "changed": [], "let in": []}
    asked = commands(made, disk)
    with stopped(asked[first], disk, STANDS.get(first, USUAL)) as child:
        found["stood"] = int(child != 0)
        before = files(disk)
        for second in seconds:
            for flags in ([], ["--overwrite"]):
                if flags and second in ANYWHERE:
                    continue
                code = ended([*asked[second], *flags])
                now = files(disk)
                found["tried"] += 1
                if code == 0 and not {first, second} & {*ANYWHERE}:
                    found["let in"].append([second, flags])
                changed = sorted(name for name, data in before.items() if now.get(name) != data)
                if changed:
                    found["changed"].append([second, flags, changed])
    shutil.rmtree(disk)
    return found


def run(asked: argparse.Namespace) -> None:
    readied()
    few = {"render", "extract", "ladder", "train"}
    made = prepared(asked.folder, not asked.verbs or not set(asked.verbs) <= few)
    every = asked.verbs or list(commands(made, asked.folder))
    for verb in every if asked.points != 0 or asked.instants else ():
        found = kills(verb, made, asked.folder / verb, asked.points, asked.instants)
        print(json.dumps(found), flush=True)
    for verb in every if asked.pairs else ():
        found = pairs(verb, every, made, asked.folder / f"{verb}-pairs")
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("verbs", nargs="*")
    parser.add_argument("--points", type=int)
    parser.add_argument("--instants", type=int, default=INSTANTS)
    parser.add_argument("--pairs", action="store_true")
    run(parser.parse_args())
