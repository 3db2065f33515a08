"""F6, F9: processes that are told to end, that die, or that hang."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from vidphys.runs import pool
from vidphys.runs.ending import INTERRUPTED, Ending
from vidphys.runs.pool import run_all
from vidphys.runs.tasks import WorkerLost, WorkerWarning

HOME = Path(__file__).parents[2]
BOTH = [signal.SIGINT, signal.SIGTERM]
LONG = int(os.environ.get("VIDPHYS_FAULTS", "0"))  # `make faults`: so many instants
AFTER = [20 * k / LONG for k in range(LONG)] if LONG else [0.0, 0.4, 1.5, 6.0]
LATER = {(0.4, signal.SIGTERM), (1.5, signal.SIGINT), (6.0, signal.SIGINT)}
LADDER = ["ladder", "--cells", "oracle/factored", "oracle/unstructured", "--seeds", "2"]
SCRIPT = """
import sys
from pathlib import Path
from tests.faults import test_processes as tasks
from vidphys.runs.ending import Ending
from vidphys.runs.pool import run_all
if __name__ == "__main__":
    given = [(Path(sys.argv[2]), name) for name in "ab"]
    ending = Ending().__enter__()
    try:
        run_all(getattr(tasks, sys.argv[1]), given, 2, print, print)
    except KeyboardInterrupt:
        sys.exit(ending.interrupted())
"""


def started(*command: str) -> subprocess.Popen:
    environment = {**os.environ, "PYTHONPATH": str(HOME), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, *command], env=environment, stderr=subprocess.PIPE, text=True
    )


def until(true, seconds: float = 90.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def heeds(process: int, number: int, how: tuple[str, ...] = ("SigCgt",)) -> bool:
    """Whether a process catches a signal (or, as ``how`` says, blocks or ignores it)."""
    status = Path(f"/proc/{process}/status").read_text().splitlines()
    masks = [int(line.split()[1], 16) for line in status if line.startswith(how)]
    return any(mask >> (number - 1) & 1 for mask in masks)


def children_of(process: int) -> list[int]:
    """The processes that one started itself and that still run."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if fields[0] != "Z":
            parents[int(path.parent.name)] = int(fields[1])
    return [child for child, parent in parents.items() if parent == process]


def below(process: int) -> list[int]:
    """All processes that descend from one."""
    found = children_of(process)
    return found + [each for child in found for each in below(child)]


def is_alive(process: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False


def ends_when_told(run: subprocess.Popen, number: int, to_all: bool = False) -> str:
    """Tell a run to end, and hold it to how it does; returns what it said."""
    workers = below(run.pid)
    began = time.monotonic()
    for process in [run.pid, *(workers if to_all else [])]:
        os.kill(process, number)
    _, said = run.communicate(timeout=60)
    assert run.returncode == INTERRUPTED, said
    assert time.monotonic() - began < (5 if LONG else 10)  # a machine under test is busy
    assert not any(word in said for word in ("Traceback", "Fatal Python error")), said
    assert "the same command goes on from here" in said
    until(lambda: not any(map(is_alive, workers)), 30)
    return said


@pytest.mark.timeout(400)
@pytest.mark.parametrize(
    ("after", "number"),
    [
        pytest.param(x, n, marks=pytest.mark.slow if (x, n) in LATER else ())
        for x in AFTER
        for n in BOTH
    ],
)
def test_f6_a_run_that_is_told_to_end_does_so_at_any_instant(tmp_path, after, number):
    run = started("-m", "vidphys", *LADDER, "--out", str(tmp_path / "r"))
    until(lambda: heeds(run.pid, signal.SIGTERM))  # Python's own start is before us
    time.sleep(after)
    ends_when_told(run, number)


def test_f6_signals_are_heeded_before_anything_heavy_is_loaded():
    code = "import sys, vidphys.__main__; print(*sys.modules)"
    loaded = subprocess.check_output([sys.executable, "-c", code], text=True, cwd=HOME).split()
    assert "vidphys.runs.ending" in loaded
    assert not {"torch", "numpy", "tyro", "rich", "vidphys.cli"} & set(loaded)


@pytest.mark.parametrize(
    "busy",
    [
        "import time\nwhile True:\n  try: time.sleep(60)\n  except KeyboardInterrupt: pass",
        "import hashlib\nhashlib.pbkdf2_hmac('sha256', b'x', b'y', 10**9)",
        "import ctypes, time\n"
        "called = ctypes.CFUNCTYPE(None)(lambda: [time.sleep(0.01) for _ in range(10**4)])\n"
        "while True: called()",
    ],
)
def test_f6_neither_a_long_call_nor_an_interrupt_that_is_swallowed_keeps_a_process(busy):
    run = started("-c", f"from vidphys.runs.ending import Ending\nEnding().__enter__()\n{busy}")
    until(lambda: heeds(run.pid, signal.SIGTERM))
    time.sleep(0.3)
    ends_when_told(run, signal.SIGTERM)


def once(folder: Path, name: str, _report) -> None:
    """Work whose process is killed the first time, in one of the tasks."""
    with (folder / name).open("a") as file:
        file.write("x")
    if name == "b" and (folder / name).read_text() == "x":
        os.kill(os.getpid(), signal.SIGKILL)


def always(folder: Path, name: str, report) -> None:
    (folder / f"{name}-{os.getpid()}").touch()
    report(f"part {name}", 1, 1)
    os.kill(os.getpid(), signal.SIGKILL)


def deaf(folder: Path, name: str, _report) -> None:
    if not (folder / name).exists():
        (folder / name).touch()
        os.kill(os.getpid(), signal.SIGSTOP)


class Odd(Exception):
    """One that cannot be taken apart and put together again."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def raises(_folder: Path, _name: str, _report) -> None:
    raise Odd(1, 2)


def mixed(folder: Path, name: str, report) -> None:
    """Tasks that are done, that die once or each time, and that fail."""
    {"c": always, "d": raises}.get(name, once)(folder, name, report)


def waits(folder: Path, name: str, _report) -> None:
    (folder / name).write_text(str(os.getpid()))
    time.sleep(600)


def result_of(work, folder: Path, names="abc") -> tuple[list[int], list[tuple[int, Exception]]]:
    done: list[int] = []
    tasks = [(folder, name) for name in names]
    return done, run_all(work, tasks, 2, lambda _: None, done.append)


def test_f6_a_task_whose_worker_is_killed_is_done_again_and_fails_alone_if_it_kills_each(tmp_path):
    """And an exception that cannot be sent arrives as its text."""
    with pytest.warns(WorkerWarning, match=r"died \(SIGKILL.*tried again"):
        done, failures = result_of(mixed, tmp_path, "abcde")
    lost, odd = (dict(failures)[number] for number in (2, 3))
    assert (sorted(done), len(failures)) == ([0, 1, 4], 2)
    assert isinstance(lost, WorkerLost)
    assert "part c died (SIGKILL, memory may have run out), as 2 did before it" in str(lost)
    assert len(list(tmp_path.glob("c-*"))) == 3
    assert str(odd) == "Odd: 1 and 2"
    assert {name: (tmp_path / name).read_text() for name in "abe"} == dict(a="x", b="xx", e="x")


@pytest.mark.slow
def test_f9_a_worker_that_gives_no_sign_of_life_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "DEAF_SECONDS", 12.0)
    with pytest.warns(WorkerWarning, match="tried again"):
        done, failures = result_of(deaf, tmp_path)
    assert (sorted(done), failures) == ([0, 1, 2], [])


def test_f9_work_without_progress_is_warned_of(tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "STUCK_SECONDS", 1.0)
    with pytest.warns(WorkerWarning, match="may be stuck"):
        result_of(slow, tmp_path)


def slow(_folder: Path, _name: str, _report) -> None:
    time.sleep(3)


@pytest.mark.parametrize(
    ("when", "number"),
    [
        *(("starting", number) for number in (*BOTH, signal.SIGKILL)),
        pytest.param("working", signal.SIGINT, marks=pytest.mark.slow),
        ("working", signal.SIGTERM),
        ("working", signal.SIGKILL),
    ],
)
def test_f6_no_worker_outlives_its_run(tmp_path, when, number):
    (tmp_path / "script.py").write_text(SCRIPT)
    run = started(str(tmp_path / "script.py"), "waits", str(tmp_path))
    until(lambda: len(below(run.pid)) >= 2 if when == "starting" else (tmp_path / "b").exists())
    workers = below(run.pid)
    if number == signal.SIGKILL:
        run.kill()
        run.communicate()
        until(lambda: not any(map(is_alive, workers)), 30)
    else:
        ends_when_told(run, number, to_all=number == signal.SIGINT)


def test_f6_no_process_can_be_told_to_end_before_it_knows_how(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    run = started(str(tmp_path / "script.py"), "waits", str(tmp_path))
    until(lambda: heeds(run.pid, signal.SIGTERM))
    while not (tmp_path / "b").exists():
        for process in children_of(run.pid):  # theirs are libraries' own (ldconfig), soon gone
            with suppress(OSError):  # Python itself catches SIGINT at first, never SIGTERM
                assert heeds(process, signal.SIGTERM, ("SigBlk", "SigCgt", "SigIgn"))
    ends_when_told(run, signal.SIGTERM)


def test_f6_being_told_again_says_nothing_more(capfd):
    with suppress(KeyboardInterrupt), Ending(grace=60) as ending:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        for _ in range(3):
            time.sleep(0.1)  # whoever waits for the first has read it
            signal.raise_signal(signal.SIGINT)
    assert ending.asked
    assert capfd.readouterr().err == ""


def test_a_unit_that_failed_and_then_succeeds_is_no_failure_of_the_run(tmp_path, monkeypatch):
    from vidphys.cli.console import Console
    from vidphys.cli.study import StudyOptions, run_study
    from vidphys.experiments.core.cell import Unit
    from vidphys.runs.folder import RunFolder

    run = RunFolder.open(tmp_path / "r", {"cells": ["t/a", "t/b"], "seeds": [0]})
    units = [Unit("t", (name,), (0,), (f"{name}-s0",)) for name in "ab"]
    run.skip("other/c", "failed: before")
    found = [[(1, WorkerLost("killed"))], []]
    monkeypatch.setattr(pool, "run_all", lambda *_args: found.pop(0))
    options, console = StudyOptions(workers=1), Console(True, 2, "x")
    assert run_study(run, units, options.sizes()[0], options, console) == 1
    assert {each["cell"] for each in run.manifest()["skipped"]} == {"other/c", "t/b"}
    assert run_study(run, units, options.sizes()[0], options, console) == 0
    assert [each["cell"] for each in run.manifest()["skipped"]] == ["other/c"]
