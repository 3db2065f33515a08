"""Room for many frames: what is large lies in a file, and is gone with the tensor."""

from __future__ import annotations

import gc
import os
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
