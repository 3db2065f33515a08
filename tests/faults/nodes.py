"""A ladder on a Ray cluster that loses nodes and drivers: is each unit there once, bit for bit?

``python -m tests.faults.nodes FOLDER [NODES] [DRIVERS]`` starts a cluster of two nodes on this
machine, and runs a small ladder by processes of the machine, by the cluster, and by the cluster
again while the second node is killed with -9 at so many random instants, then while the driver is,
whose command is then given again. It prints a line of JSON for each run: which units were lost,
which rows of the records came twice, and what is not equal, bit for bit, to the first run. It
needs Ray, and takes a quarter of an hour.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.faults.remains import left
from tests.shared.nodes import cluster, node

NODES, DRIVERS, WAIT = 10, 5, 400.0
CELLS = ("oracle/unstructured", "renderer/unstructured")
SEEDS = 3
SHARED = (".safetensors", ".entry", ".csv", ".avi", ".parquet")
UNITS = len(CELLS) * SEEDS
VERB = """
import sys
from tests.shared.small_studies import TINY
from vidphys import presets
from vidphys.cli import main
if __name__ == "__main__":
    presets.PRESETS["quick"] = TINY
    sys.exit(main(sys.argv[1:]))
"""


def begun(folder: Path, address: str | None) -> subprocess.Popen[bytes]:
    """The ladder, by a cluster or by processes of this machine."""
    script = folder.parent / "verb.py"
    script.write_text(VERB)
    engine = ["--engine", "ray", "--address", address] if address else []
    asked = ["ladder", "--cells", *CELLS, "--seeds", str(SEEDS), *engine, "--out", str(folder)]
    with Path(f"{folder}.said").open("ab") as said:
        environ = {**os.environ, "PYTHONPATH": str(Path.cwd())}
        words = [sys.executable, str(script), *asked, "--quiet"]
        return subprocess.Popen(words, stdout=said, stderr=said, env=environ)


def parts(folder: Path) -> dict[str, int]:
    """The tables of units that are done, and when each was written."""
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("parts/*.parquet")}


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + WAIT
    while not true():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {WAIT:.0f} s in vain")
        time.sleep(0.02)


def found_in(folder: Path) -> dict[str, object]:
    """All that two runs must share, by name: rows without their times, tensors, labels."""
    return {name: found for name, found in left(folder).items() if Path(name).suffix in SHARED}


def told(way: str, folder: Path, code: int, first: dict[str, object], **more: object) -> None:
    now = found_in(folder)
    rows = Counter(now.get("records.parquet", ()))
    done = {tuple(name.split(".")[:1]) for name in parts(folder) if ".records." in name}
    found = {
        "way": way,
        "code": code,
        "lost": UNITS - len(done),
        "rows": sum(rows.values()),
        "twice": sum(count > 1 for count in rows.values()),
        "differ": sorted(name for name in {*first, *now} if first.get(name) != now.get(name)),
    }
    print(json.dumps({**found, **more}), flush=True)


def undisturbed(folder: Path, address: str) -> tuple[int, float]:
    """Its exit code, and the seconds between its folder and the last of its parts."""
    run = begun(folder, address)
    until((folder / "run.json").exists)
    began = time.monotonic()
    until(lambda: len(parts(folder)) == 2 * UNITS or run.poll() is not None)
    seconds = time.monotonic() - began
    return run.wait(), seconds


def after(run: subprocess.Popen[bytes], folder: Path, seconds: float) -> None:
    """So many seconds after its folder is there, or when it ended."""
    until(lambda: (folder / "run.json").exists() or run.poll() is not None)
    instant = time.monotonic() + seconds
    until(lambda: time.monotonic() > instant or run.poll() is not None)


def run(folder: Path, nodes: int, drivers: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    code = begun(folder / "local", None).wait()
    first = found_in(folder / "local")
    told("local", folder / "local", code, first)
    rng = np.random.default_rng(0)
    with cluster(cores=1) as made:
        other = made.add_node(**node(1))
        code, seconds = undisturbed(folder / "ray", made.address)
        told("ray", folder / "ray", code, first, seconds=seconds)
        for number in range(nodes):
            here = folder / f"node-{number}"
            instant = rng.uniform(0, seconds)
            work = begun(here, made.address)
            after(work, here, instant)
            done = len(parts(here)) // 2
            made.remove_node(other, allow_graceful=False)
            code = work.wait()
            told("node killed", here, code, first, instant=instant, done_before=done)
            other = made.add_node(**node(1))
            shutil.rmtree(here)
        for number in range(drivers):
            here = folder / f"driver-{number}"
            instant = rng.uniform(0, seconds)
            work = begun(here, made.address)
            after(work, here, instant)
            work.kill()
            work.wait()
            before = parts(here)
            code = begun(here, made.address).wait()
            again = [name for name, when in before.items() if parts(here)[name] != when]
            more = {"instant": instant, "done_before": len(before) // 2, "written_again": again}
            told("driver killed", here, code, first, **more)
            shutil.rmtree(here)


if __name__ == "__main__":
    numbers = [int(each) for each in sys.argv[2:]]
    run(Path(sys.argv[1]), *(numbers + [NODES, DRIVERS][len(numbers) :]))
