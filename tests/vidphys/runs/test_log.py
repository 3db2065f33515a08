"""What a unit of work says lies in a file of its own, while it works and after."""

import os
import re
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from vidphys.runs.folder import RunFolder
from vidphys.runs.log import logged
from vidphys.runs.pool import run_all


def talks(folder: Path, name: str, report) -> None:
    print(f"{name} prints")
    os.write(1, b"compiled code prints\n")
    print("an error", file=sys.stderr)
    warnings.warn("energy is lost", UserWarning, stacklevel=1)
    report(f"{name}: training", 1, 2)
    (folder / f"{name}.meanwhile").write_text((folder / f"{name}.log").read_text())
    report(f"{name}: training", 2, 2)


def fails(_folder: Path, name: str, _report) -> None:
    raise ValueError(f"{name} cannot be done")


def dies(_folder: Path, _name: str, _report) -> None:
    os.write(2, b"terminate called\n")
    os.kill(os.getpid(), signal.SIGKILL)


def lines_of(log: Path) -> list[str]:
    return [
        re.sub(r"^\d{4}-\d\d-\d\dT[\d:]{8}\+00:00 ", "", x) for x in log.read_text().split("\n")
    ]


def test_a_worker_keeps_what_each_unit_says_and_what_it_took(tmp_path, capfd):
    tasks = [(talks, tmp_path / f"{name}.log", (tmp_path, name)) for name in "ab"]
    assert run_all(logged, tasks, 1, lambda _: None, lambda _: None) == []
    assert capfd.readouterr() == ("", "")  # none of it is lost among what the verb shows
    for name in "ab":
        first, *said, end, last = lines_of(tmp_path / f"{name}.log")
        assert re.fullmatch(r"begins in process \d+", first) and last == ""
        told = [line for line in said if "warnings.warn" not in line]
        assert told[:3] == [f"{name} prints", "compiled code prints", "an error"]
        assert "UserWarning: energy is lost" in told[3]  # of the second one too
        assert told[4:] == [f"{name}: training"]
        took = r"done: (.+) s, (.+) s of them at work, (\d+) MiB of memory at most"
        seconds, computed, mib = map(float, re.fullmatch(took, end).groups())
        assert 0 <= computed <= seconds + 0.1 and seconds < 60 and mib > 50
        meanwhile = (tmp_path / f"{name}.meanwhile").read_text()
        assert meanwhile.endswith(f"{name}: training\n") and "done" not in meanwhile


def test_a_unit_that_fails_or_dies_says_how_and_the_next_try_stands_below(tmp_path):
    log = tmp_path / "a.log"
    with pytest.raises(ValueError, match="a cannot be done"):
        logged(fails, log, (tmp_path, "a"), lambda *_: None)
    said = lines_of(log)
    assert "ValueError: a cannot be done" in said and said[-2].startswith("failed: ")
    with pytest.warns(UserWarning, match="tried again"):
        run_all(logged, [(dies, log, (tmp_path, "a"))], 1, lambda _: None, lambda _: None)
    below = lines_of(log)[len(said) - 1 :]
    assert [line.split()[0] for line in below if line] == 3 * ["begins", "terminate"]


def test_a_link_in_place_of_a_log_is_not_followed(tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("mine")
    (tmp_path / "a.log").symlink_to(precious)
    with pytest.raises(OSError):
        logged(talks, tmp_path / "a.log", (tmp_path, "a"), lambda *_: None)
    assert precious.read_text() == "mine"


FULL = """
import resource, sys
from pathlib import Path
from vidphys.runs.log import logged
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # as a disk without room
try:
    logged(print, Path(sys.argv[1]), (), print)
except OSError:
    print("no room")
"""


def test_where_there_is_no_room_no_empty_log_is_left(tmp_path):
    asked = [sys.executable, "-B", "-c", FULL, str(tmp_path / "a.log")]
    told = subprocess.run(asked, capture_output=True, text=True, check=True, timeout=100)
    assert "no room" in told.stdout and list(tmp_path.iterdir()) == []


def test_logs_go_with_the_run_that_is_given_up(tmp_path):
    run = RunFolder.open(tmp_path / "r", {"kind": "a", "cells": [], "seeds": []})
    log = run.log("a/b-s0")
    logged(print, log, (), lambda *_: None)
    assert log == tmp_path / "r" / "logs" / "a-b-s0.log" and log.exists()
    RunFolder.open(tmp_path / "r", {"kind": "b", "cells": [], "seeds": []}, overwrite=True)
    assert not log.exists()
