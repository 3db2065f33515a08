"""Z12, Z13: a test cannot reach the network, and a verb does not try to."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vidphys.cli import main

WATCHED = """
import socket, sys
asked = []
sys.addaudithook(lambda event, args: asked.append(event)
                 if event in ("socket.connect", "socket.getaddrinfo", "socket.bind") else None)
from vidphys.cli import main
for verb in sys.argv[1].splitlines():
    asked.clear()
    main(verb.split())
    print("ASKED", verb.split()[0], asked)
"""


def test_z12_the_fixture_blocks_what_leaves_this_machine():
    for ask in (
        lambda: socket.create_connection(("192.0.2.1", 80), timeout=1),
        lambda: socket.getaddrinfo("example.org", 80),
    ):
        with pytest.raises(pytest.fail.Exception, match="tried to reach the network"):
            ask()


@pytest.fixture
def table(tmp_path) -> Path:
    t = np.arange(30) / 30
    rows = "\n".join(f"{a:.4f},{1 + a:.5f},{2 - 4.9 * a * a:.5f}" for a in t)
    (tmp_path / "a.csv").write_text(f"t,x,y\n{rows}\n")
    return tmp_path / "a.csv"


def test_z12_no_verb_opens_a_socket(tmp_path, table):
    """One process asks them all, so that what they share is imported once."""
    verbs = {
        "doctor": "",
        "weights": "check",
        "extract": f"{table} --encoder dinov2-small --out {tmp_path / 'store'}",
        "diagnose": f"{table} --out {tmp_path / 'run'} --quiet",
    }
    words = "\n".join(f"{verb} {rest}" for verb, rest in verbs.items())
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, words], capture_output=True, text=True, timeout=220
    )
    told = [line for line in done.stdout.splitlines() if line.startswith("ASKED ")]
    assert told == [f"ASKED {verb} []" for verb in verbs], done.stderr
    assert "Traceback" not in done.stderr


def test_z12_z13_libraries_are_told_to_stay_at_home(monkeypatch):
    for name in ("HF_HUB_OFFLINE", "HF_HUB_DISABLE_TELEMETRY", "RERUN_ANALYTICS"):
        monkeypatch.setenv(name, "x")  # is put back after the test
        monkeypatch.delenv(name)
    assert main(["parts"]) == 0
    found = {name: os.environ[name] for name in ("HF_HUB_OFFLINE", "HF_HUB_DISABLE_TELEMETRY")}
    assert found == {"HF_HUB_OFFLINE": "1", "HF_HUB_DISABLE_TELEMETRY": "1"}
    assert os.environ["RERUN_ANALYTICS"] == "0"


def test_z13_a_record_tells_nothing_of_the_machine_or_its_user(tmp_path, table, monkeypatch):
    monkeypatch.setenv("VIDPHYS_SECRET", "swordfish")
    monkeypatch.setenv("USER", "ada-lovelace")
    assert main(["diagnose", str(table), "--out", str(tmp_path / "run"), "--quiet"]) == 0
    spoken = [
        b"swordfish",
        b"ada-lovelace",
        socket.gethostname().encode(),
        str(Path.home()).encode(),
    ]
    spoken = [word for word in spoken if len(word) > 5]
    for file in (path for path in (tmp_path / "run").rglob("*") if path.is_file()):
        data = file.read_bytes()
        assert not [word for word in spoken if word in data], file.name
    held = json.loads((tmp_path / "run" / "run.json").read_text())
    assert not re.search(r"environ|hostname|user", json.dumps(held["settings"]))
