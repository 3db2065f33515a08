"""F1, F7: verbs killed at their file operations, and verbs that want the folder of another one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

VERBS = 16
HOME = Path(__file__).parents[2]
LONG = bool(os.environ.get("VIDPHYS_FAULTS"))  # `make faults`: each verb, operation and pair
SHORT = "render", "extract", "--points", "3", "--instants", "0"


@pytest.mark.timeout(14000 if LONG else 600)
def test_f1_f7_a_kill_locks_nothing_out_and_no_verb_changes_what_another_makes(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(HOME), "OMP_NUM_THREADS": "1"}
    asked = [str(tmp_path), *(() if LONG else SHORT), "--pairs"]
    done = subprocess.run(
        [sys.executable, "-m", "tests.faults.kills", *asked],
        env={**environment, "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert len(found) == 2 * (VERBS if LONG else 2)
    for each in found:
        if "verb" in each:
            assert each["operations"] > 3
            assert each["kills"] >= 2
            assert (each["locked out"], each["differ"]) == ([], []), each["verb"]
        else:
            assert each["stood"], each["first"]
            assert each["tried"] >= 3
            assert (each["changed"], each["let in"]) == ([], []), each["first"]
