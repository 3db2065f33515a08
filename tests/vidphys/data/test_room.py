"""Room for many frames: what is large lies in a file, and is gone with the tensor."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from vidphys.data import room as rooms
from vidphys.data.room import room

SHAPE, MAPS = (5, 4, 3), Path("/proc/self/maps")


def mapped(folder) -> list[str]:
    return [line for line in MAPS.read_text().splitlines() if str(folder) in line]


@pytest.mark.skipif(not MAPS.exists(), reason="asks the system what is mapped")
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32])
def test_what_is_large_lies_in_a_file_that_is_gone_with_it(tmp_path, monkeypatch, dtype):
    monkeypatch.setattr(rooms, "HELD", 5 * 4 * 3 * dtype.itemsize - 1)
    given = torch.randn(SHAPE).to(dtype)
    found = room(SHAPE, dtype, tmp_path)
    found.copy_(given)
    assert torch.equal(found, given)
    assert mapped(tmp_path)
    assert list(tmp_path.iterdir()) == []  # it has no name
    del found
    gc.collect()
    assert not mapped(tmp_path)


@pytest.mark.parametrize("folder", [True, False])
def test_what_is_small_or_has_no_folder_lies_in_memory(tmp_path, monkeypatch, folder):
    monkeypatch.setattr(rooms, "HELD", rooms.HELD if folder else 0)
    found = room(SHAPE, torch.float32, tmp_path / "new" if folder else None)
    assert found.shape == SHAPE
    assert not (tmp_path / "new").exists()


def test_a_full_disk_is_told_before_anything_is_written(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(rooms, "HELD", 0)
    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    with pytest.raises(OSError, match="No space"):
        room(SHAPE, torch.float32, tmp_path)
    assert list(tmp_path.iterdir()) == []


JOIN = """
import sys
from pathlib import Path

import torch
from readouts.scale import FeatureScale
from vidphys.data import room
from vidphys.data.labelled import LabelledFrames, joined

room.HELD = 0  # features lie in a file, whatever they take

def held():
    status = Path("/proc/self/status").read_text()
    return int(status.split("RssAnon:")[1].split()[0]) / 1024  # MiB

def parts(count, frames):
    for _ in range(count):
        values, one = torch.zeros(frames, 64, 14, 14), torch.ones(frames, 1)
        yield LabelledFrames(values, torch.zeros(14, 14, 2), torch.zeros(frames, 1, 2), one)

begin = held()
frames = joined(parts(100, 64), 6400, Path(sys.argv[1]))  # 306 MiB of features
FeatureScale(64).fit(frames.values)
print(held() - begin)
"""


@pytest.mark.skipif(not MAPS.exists(), reason="asks the system what is held")
def test_frames_are_joined_and_measured_in_little_memory(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", JOIN, tmp_path], capture_output=True, text=True, check=True
    )
    assert float(done.stdout) < 100
