"""F1, F7: a run folder that two processes want, or that a kill left in the middle of something."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from vidphys.errors import InputError
from vidphys.runs import aside
from vidphys.runs.folder import RunFolder

OLD = {"preset": "quick", "cells": ["a/b"], "seeds": [0]}
MORE = {**OLD, "cells": ["c/d"]}
OTHER = {**OLD, "preset": "paper"}
NOBODY = 10**9  # no process has so high a number


class Kill(BaseException):
    """Stands for kill -9: nothing is cleaned up after it that a process would have to do."""


def bytes_of(folder: Path) -> dict[str, bytes]:
    found = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def worked(path: Path, settings: dict = OLD) -> RunFolder:
    run = RunFolder.open(path, settings)
    for name in ("parts/a.txt", "checkpoints/a/head.json", "figures/a.svg"):
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_text(name)
    return run


@pytest.mark.parametrize("settings", [OLD, MORE, OTHER])
@pytest.mark.parametrize("overwrite", [False, True])
def test_f7_a_second_process_changes_no_byte_of_the_first(tmp_path, settings, overwrite):
    worked(tmp_path / "r")
    with RunFolder.at_work(tmp_path / "r", OLD):
        before = bytes_of(tmp_path / "r")
        with pytest.raises(InputError, match="another process is at work in it"):
            RunFolder.open(tmp_path / "r", settings, overwrite)
        assert bytes_of(tmp_path / "r") == before


def test_f7_a_lock_that_is_abandoned_while_another_waits_to_take_it_is_not_taken(tmp_path):
    with RunFolder.at_work(tmp_path / "r", OLD) as run:
        run.abandon()
        with (
            RunFolder.at_work(tmp_path / "r", OTHER),
            pytest.raises(InputError, match="another process"),
        ):
            RunFolder.open(tmp_path / "r", OTHER)


@pytest.mark.parametrize("kind", ["link", "dangling", "fifo", "folder"])
def test_a_lock_that_is_not_a_plain_file_is_neither_followed_nor_emptied(tmp_path, kind):
    folder, precious = tmp_path / "r", tmp_path / "precious"
    folder.mkdir()
    precious.write_text("mine")
    if kind == "fifo":
        os.mkfifo(folder / ".lock")
    elif kind == "folder":
        (folder / ".lock").mkdir()
    else:
        (folder / ".lock").symlink_to(precious if kind == "link" else tmp_path / "new")
    with pytest.raises(InputError, match=r"\.lock|cannot be written"):
        RunFolder.open(folder, OLD)
    assert precious.read_text() == "mine"
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "left", [[".lock"], [f".run.json.{NOBODY}.partial"], [".lock", f".a.{NOBODY}.partial"]]
)
def test_f1_what_a_kill_in_the_first_write_leaves_does_not_lock_the_folder_out(tmp_path, left):
    folder = tmp_path / "r"
    folder.mkdir()
    for name in left:
        (folder / name).write_text("{")
    RunFolder.open(folder, OLD)
    assert sorted(path.name for path in folder.iterdir()) == [".lock", "run.json"]


def test_f1_the_holder_sweeps_what_was_half_written_and_nothing_of_anybody_else(tmp_path):
    worked(tmp_path / "r")
    stale = tmp_path / "r" / "checkpoints" / "a" / f".head-1.safetensors.{NOBODY}.partial"
    (tmp_path / "r" / "mine").mkdir()
    mine = tmp_path / "r" / "mine" / f".x.{NOBODY}.partial"
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / f".x.{NOBODY}.partial").write_text("x")
    (tmp_path / "r" / "clips").symlink_to(outside)
    for path in (stale, mine):
        path.write_text("half")
    RunFolder.open(tmp_path / "r", OLD)
    assert not stale.exists()
    assert mine.exists()
    assert (outside / f".x.{NOBODY}.partial").exists()


def test_the_holder_leaves_what_another_process_writes_beside_it(tmp_path):
    worked(tmp_path / "r")
    ended = subprocess.Popen(["true"])
    ended.wait()
    lively = os.getppid()
    names = (".a.{}.partial", ".b.{}.partial.rrd", ".\n.{}.partial")
    kept = [tmp_path / "r" / name.format(lively) for name in names]
    gone = [tmp_path / "r" / names[1].format(pid) for pid in (os.getpid(), ended.pid, 10**30)]
    stale = tmp_path / "r" / f".old.{lively}.partial"
    for path in (*kept, *gone, stale):
        path.write_text("half")
    os.utime(stale, (0, 0))
    RunFolder.open(tmp_path / "r", OLD)
    assert all(path.exists() for path in kept)
    assert not any(path.exists() for path in (*gone, stale))


def test_a_run_that_is_given_up_is_deleted_last_and_comes_back_where_nothing_began(tmp_path):
    worked(tmp_path / "r")
    before = bytes_of(tmp_path / "r")
    with RunFolder.at_work(tmp_path / "r", OTHER, overwrite=True) as run:
        assert len(list(run.path.glob(".given-up-*/parts/*"))) == 1
        run.abandon()
    assert bytes_of(tmp_path / "r") == before
    with pytest.raises(Kill), RunFolder.at_work(tmp_path / "r", OTHER, overwrite=True):
        raise Kill
    assert list((tmp_path / "r").glob(".given-up-*"))
    RunFolder.open(tmp_path / "r", OTHER)
    assert sorted(bytes_of(tmp_path / "r")) == [".lock", "run.json"]


def test_f1_a_kill_between_any_two_file_operations_of_an_overwrite_loses_nothing(
    tmp_path, monkeypatch
):
    """The old run's command finds the old run whole; the new one's ends in the new run alone."""
    lived = False
    for last in range(40):
        for settings, overwrite in ((OLD, False), (OTHER, True)):
            path = tmp_path / f"{last}-{overwrite}"
            worked(path)
            before = bytes_of(path)
            with monkeypatch.context() as m:
                _kill_after(m, last)
                try:
                    RunFolder.open(path, OTHER, overwrite=True)
                    lived = True
                except Kill:
                    lived = False
            try:
                RunFolder.open(path, settings, overwrite)
            except InputError as error:
                assert "other settings" in str(error)  # the new run had taken its place
            manifest = json.loads((path / "run.json").read_text())
            new = manifest["settings"]["preset"] == "paper"
            if overwrite:
                assert new
                assert sorted(bytes_of(path)) == [".lock", "run.json"]
            elif not new:
                assert set(bytes_of(path)) == set(before)
        if lived:
            break
    assert lived
    assert last > 5


def _kill_after(monkeypatch: pytest.MonkeyPatch, operations: int) -> None:
    left = [operations]

    def counted(function):
        def call(*args, **kwargs):
            if left[0] == 0:
                raise Kill
            left[0] -= 1
            return function(*args, **kwargs)

        return call

    for name in ("rename", "replace", "mkdir"):
        monkeypatch.setattr(Path, name, counted(getattr(Path, name)))
    monkeypatch.setattr(aside.shutil, "rmtree", counted(aside.shutil.rmtree))


@pytest.mark.parametrize("text", ["", "{", "[]", '{"settings": 1}', "[" * 100_000])
def test_a_damaged_run_json_is_named_in_one_line(tmp_path, text):
    worked(tmp_path / "r")
    (tmp_path / "r" / "run.json").write_text(text)
    with pytest.raises(InputError, match=r"run\.json: not readable as a run"):
        RunFolder.open(tmp_path / "r", OLD)


def test_f12_a_newer_schema_is_refused_by_name(tmp_path):
    run = worked(tmp_path / "r")
    run.manifest_path.write_text(json.dumps({**run.manifest(), "schema_version": 99}))
    with pytest.raises(InputError, match=r"run\.json: schema version 99, this vidphys reads"):
        RunFolder.open(tmp_path / "r", OLD, overwrite=True)


@pytest.mark.parametrize("out", ["file", "file/below", "dangling"])
def test_f4_a_folder_that_cannot_be_is_refused_in_one_line(tmp_path, out):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere" / "at all")
    with pytest.raises(InputError, match="cannot be"):
        RunFolder.open(tmp_path / out, OLD)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("name", ["with spaces", "ünïcode 振り子", "n" * 255])
def test_f11_a_folder_of_any_name_and_behind_a_link_works(tmp_path, name):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    RunFolder.open(tmp_path / "link" / name, OLD)
    assert (tmp_path / "real" / name / "run.json").exists()
