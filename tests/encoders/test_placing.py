"""Files come into their places together, once all of them are safe."""

from __future__ import annotations

import os

import pytest

from encoders.placing import place


@pytest.mark.parametrize("count", [1, 2, 24])
def test_nothing_is_renamed_before_all_is_synced(tmp_path, monkeypatch, count):
    files = {tmp_path / f"{k}.partial": tmp_path / f"{k}" for k in range(count)}
    for file in files:
        file.write_text(file.name)
    synced = set()

    def fsync(number):
        assert not any(path.exists() for path in files.values())
        synced.add(os.fstat(number).st_ino)

    monkeypatch.setattr(os, "fsync", fsync)
    place(files)
    assert synced == {path.stat().st_ino for path in files.values()}
    assert {path.read_text() for path in files.values()} == {file.name for file in files}


@pytest.mark.parametrize("count", [2, 24])
def test_where_one_cannot_be_synced_none_comes_into_its_place(tmp_path, monkeypatch, count):
    files = {tmp_path / f"{k}.partial": tmp_path / f"{k}" for k in range(count)}
    for file in files:
        file.touch()
    bad = (tmp_path / f"{count // 2}.partial").stat().st_ino

    def fsync(number):
        if os.fstat(number).st_ino == bad:
            raise OSError("disk is full")

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OSError, match="disk is full"):
        place(files)
    assert not any(path.exists() for path in files.values())
