"""Verbs on a disk that is full at each point of their work, and then has room again.

``python -m tests.faults.full_disk VERB FOLDER POINTS`` is run where it may mount a disk of memory
(``unshare --user --map-root-user --mount``); the last line that it prints is what it found.
"""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from tests.faults.remains import differing, left, shared
from tests.shared.serial import serially
from tests.shared.small_clips import know_cells, write_clip
from tests.shared.small_studies import TINY
from vidphys import presets
from vidphys.cli import main
from vidphys.runs import pool

MIB, PAGE = 2**20, 4096
ROOM = 64 * MIB
VERBS = ("render", "train", "ladder")


def mount(disk: Path, size: int, again: bool = False) -> None:
    options = f"{'remount,' if again else ''}size={size}"
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(disk)], check=True)


def unmount(disk: Path) -> None:
    subprocess.run(["umount", "--lazy", str(disk)], check=True)  # features stay mapped


def said(work: Callable[[], int]) -> tuple[int, str]:
    """Exit code and what was said of it."""
    heard = io.StringIO()
    with contextlib.redirect_stderr(heard), contextlib.redirect_stdout(io.StringIO()):
        code = work()
    return code, heard.getvalue()


def empty(disk: Path) -> list[str]:
    """Files of no byte under a name that is not a lock's."""
    files = (path for path in disk.rglob("*") if path.is_file() and path.name != ".lock")
    return [str(path.relative_to(disk)) for path in files if path.stat().st_size == 0]


def command(verb: str, folder: Path, disk: Path) -> list[str]:
    out = ["--out", str(disk / "run"), "--quiet"]
    if verb == "render":
        return ["render", "--clips", "4", "--frames", "4", "--image", "16", *out]
    if verb == "ladder":
        return ["ladder", "--cells", "oracle/unstructured", "--workers", "1", *out]
    for k in range(3 if not (folder / "mine").exists() else 0):
        write_clip(folder / "mine" / f"clip{k}.avi", 12, phase=k)
    store = ["--store", str(disk / "features"), "--encoder", "cells", "--readout", "attention"]
    sizes = ["--steps", "4", "--head-steps", "2", "--shift", "1"]
    return ["train", str(folder / "mine"), *store, *sizes, *out]


def sweep(verb: str, folder: Path, points: int) -> dict[str, object]:
    disk = folder / "disk"
    disk.mkdir()
    arguments = command(verb, folder, disk)
    runs = []
    for _ in range(2):
        mount(disk, ROOM)
        code, heard = said(lambda: main(arguments))
        assert code == 0, heard
        runs.append(left(disk))
        used = subprocess.check_output(["du", "-sB1", str(disk)]).split()[0]
        unmount(disk)
    whole = shared(*runs)
    found = {"points": 0, "full": 0, "tracebacks": [], "empty": [], "lost": [], "differ": []}
    for size in np.unique(np.linspace(PAGE, int(used), points, endpoint=False) // PAGE * PAGE):
        mount(disk, int(size))
        code, heard = said(lambda: main(arguments))
        found["points"] += 1
        found["full"] += code != 0
        if "Traceback" in heard or "mistake of vidphys" in heard or code not in (0, 1, 2):
            found["tracebacks"].append([int(size), heard])
        found["empty"] += empty(disk)
        mount(disk, ROOM, again=True)
        code, heard = said(lambda: main(arguments))
        if code != 0:
            found["lost"].append([int(size), heard])
        elif wrong := differing(disk, whole):
            found["differ"].append([int(size), wrong])
        unmount(disk)
    return found


if __name__ == "__main__":
    import pytest

    torch.set_num_threads(1)
    presets.PRESETS["quick"] = TINY
    pool.run_all = serially
    know_cells(pytest.MonkeyPatch())
    print(json.dumps(sweep(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))))
