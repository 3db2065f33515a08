"""F4: a disk that is full at some point of the work; nothing is lost, and it goes on with room."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vidphys.data import rendered
from vidphys.data.rendered import write_video

HOME = Path(__file__).parents[2]
APART = ["unshare", "--user", "--map-root-user", "--mount"]
POINTS = int(os.environ.get("VIDPHYS_FAULTS", "0"))  # of each verb; `make faults` sets it


def can_mount(folder: Path) -> bool:
    try:
        command = [*APART, "mount", "-t", "tmpfs", "tmpfs", str(folder)]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


@pytest.mark.timeout(3000 if POINTS else 400)
@pytest.mark.parametrize(
    ("verb", "points"),
    [("render", 6), pytest.param("train", 1, marks=pytest.mark.slow), ("ladder", 0)],
)
def test_f4_a_full_disk_loses_nothing_and_the_same_command_goes_on(tmp_path, verb, points):
    if not (POINTS or points):
        pytest.skip("takes minutes: make faults")
    if not can_mount(tmp_path):
        pytest.skip("no disk of memory can be mounted here")
    command = [sys.executable, "-m", "tests.faults.full_disk", verb, tmp_path, POINTS or points]
    environment = {**os.environ, "PYTHONPATH": str(HOME), "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [*APART, *map(str, command)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["full"] > 0
    problems = {name: found[name] for name in ("tracebacks", "empty", "lost", "differ")}
    assert problems == {"tracebacks": [], "empty": [], "lost": [], "differ": []}


@pytest.mark.parametrize("kept", [0, 4096, 16384])
def test_f4_a_clip_that_the_codec_could_not_write_whole_gets_no_name(tmp_path, monkeypatch, kept):
    frames = np.random.default_rng(0).integers(0, 255, (4, 64, 64, 3), dtype=np.uint8)
    holds = rendered._holds

    def cut_short(cv2, path, frames):
        path.write_bytes(path.read_bytes()[:kept])
        return holds(cv2, path, frames)

    monkeypatch.setattr(rendered, "_holds", cut_short)
    with pytest.raises(OSError, match="not written whole") as raised:
        write_video(tmp_path / "a.partial", frames, 10.0)
    assert raised.value.errno == errno.ENOSPC
    assert list(tmp_path.iterdir()) == []


RECORD = """
import resource, sys
from pathlib import Path

import numpy as np
from viz.rolled import Rolled, write_rolled_recording

resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))  # as a disk that is full after a page
times = np.arange(50) * 0.1
try:
    rolled = Rolled({"model": (times, np.zeros((50, 1, 2)))})
    write_rolled_recording(rolled, {"cell": "a"}, Path(sys.argv[1]))
except OSError as error:
    print(error.errno)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of a file's size")
def test_f4_a_recording_for_which_there_is_no_room_is_refused_and_waits_for_nothing(tmp_path):
    # -B: what the child imports first would be cut short as well, for all who import it later
    asked = [sys.executable, "-B", "-c", RECORD, tmp_path / "a.rrd"]
    done = subprocess.run(asked, capture_output=True, text=True, check=True, timeout=100)
    assert int(done.stdout) == errno.EFBIG
    assert list(tmp_path.iterdir()) == []
