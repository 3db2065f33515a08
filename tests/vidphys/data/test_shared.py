"""Many workers, one store: each clip once, the same bytes, whoever dies, sleeps or comes late."""

from __future__ import annotations

import io
import multiprocessing
import os
import signal
import tarfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from encoders.placing import sweep
from encoders.store import FeatureStore
from tests.shared.small_clips import Cells, CellsSettings, cells, write_clip  # noqa: F401
from vidphys.cli import main
from vidphys.data import units as slicing
from vidphys.data.listed import listed_clips
from vidphys.data.many import Wanted, extract_many
from vidphys.data.shared import Extraction
from vidphys.data.units import Units, write_units
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError

fork = multiprocessing.get_context("fork")
CLIPS, LAYERS, LEASE = 9, ("4", "8"), 0.8


@pytest.fixture
def clips(tmp_path, monkeypatch):
    monkeypatch.setattr(slicing, "SLICE", 2)
    for number in range(CLIPS):
        write_clip(tmp_path / "clips" / f"{number}.avi", 3 + number % 3, number, table=False)
    return tmp_path / "clips"


def opened(path):
    return open_video(path, ClipSelection())


def work(folder, clips, layers=LAYERS):
    store = FeatureStore(folder)
    wanted = Wanted(Cells(CellsSettings(), "0" * 64), layers, store, "float32")
    return Extraction(store, [clips], wanted, {})


def bytes_of(folder):
    """All that is left, when what is half-written is swept; an index too is always the same."""
    shards = folder / "shards"
    for path in shards.glob(".*.partial"):
        os.utime(path, (0, 0))
    sweep(shards)
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def alone(tmp_path, clips):
    outcome = work(tmp_path / "alone", clips).run(opened)
    assert (outcome.units, outcome.here, outcome.clips) == (5, 5, CLIPS)
    assert outcome.entries == 2 * CLIPS and outcome.failed == ()
    return bytes_of(tmp_path / "alone")


def check(folder, alone):
    assert bytes_of(folder) == alone
    store = FeatureStore(folder)
    keys = [entry["key"] for entry in store.entries()]
    assert len(keys) == len(set(keys)) == 2 * CLIPS and store.verify() == []


def test_the_entries_are_those_of_a_plain_extraction(tmp_path, clips, alone):
    plain = FeatureStore(tmp_path / "plain")
    wanted = Wanted(Cells(CellsSettings(), "0" * 64), LAYERS, plain, "float32")
    extract_many(map(opened, listed_clips([clips])), wanted, lambda video, made: None)
    shared = FeatureStore(tmp_path / "alone")
    by_key = {entry["key"]: entry for entry in shared.entries()}
    assert by_key == {entry["key"]: entry for entry in plain.entries()}
    for video in map(opened, listed_clips([clips])):
        for request in wanted.requests(video).values():
            one, other = shared.read(request), plain.read(request)
            assert torch.equal(one.values, other.values) and one.stride == other.stride
            assert shared.has(request) and one.values.shape[1] == len(video.frames)
    passes = Cells.passes
    again = work(tmp_path / "alone", clips).run(opened)
    assert again.here == 0 and again.clips == CLIPS and Cells.passes == passes
    extract_many(map(opened, listed_clips([clips])), replace(wanted, store=shared), lambda v, m: 0)
    assert Cells.passes == passes


def _works(folder, clips, log, slowly=0.0):
    def slow(path):
        time.sleep(slowly)
        with log.open("a") as file:
            file.write(f"{path.name}\n")
        return opened(path)

    work(folder, clips).run(slow, lease=LEASE)


def started(*arguments):
    process = fork.Process(target=_works, args=arguments)
    process.start()
    return process


def ended(*workers):
    for worker in workers:
        worker.join(120)
        assert worker.exitcode == 0


def test_workers_at_once_share_the_units_and_make_none_twice(tmp_path, clips, alone):
    log = tmp_path / "log"
    ended(*[started(tmp_path / "s", clips, log, 0.02) for _ in range(3)])
    assert sorted(log.read_text().split()) == [f"{n}.avi" for n in range(CLIPS)]
    check(tmp_path / "s", alone)


def test_workers_that_are_killed_lose_nothing_and_nothing_comes_twice(tmp_path, clips, alone):
    log, rng = tmp_path / "log", np.random.default_rng(0)
    for _ in range(6):
        worker = started(tmp_path / "s", clips, log, 0.03)
        time.sleep(rng.uniform(0.02, 0.5))
        worker.kill()
        worker.join(60)
    ended(*[started(tmp_path / "s", clips, log) for _ in range(2)])
    check(tmp_path / "s", alone)


@pytest.mark.parametrize(
    "operation", ["rename", "replace", pytest.param("unlink", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("at", [0, *(pytest.param(x, marks=pytest.mark.slow) for x in (1, 2))])
def test_a_kill_before_what_changes_names(tmp_path, clips, alone, operation, at):
    def dies():
        original, calls = getattr(Path, operation), []

        def counted(*arguments, **options):
            calls.append(1)
            if len(calls) == 3 * at + 1:
                os.kill(os.getpid(), signal.SIGKILL)
            return original(*arguments, **options)

        setattr(Path, operation, counted)
        _works(tmp_path / "s", clips, tmp_path / "log")

    worker = fork.Process(target=dies)
    worker.start()
    worker.join(60)
    assert worker.exitcode in (-signal.SIGKILL, 0)
    ended(started(tmp_path / "s", clips, tmp_path / "log"))
    check(tmp_path / "s", alone)


def test_one_that_slept_through_its_lease_adds_nothing_when_it_wakes(tmp_path, clips, alone):
    log = tmp_path / "log"
    sleeper = started(tmp_path / "s", clips, log, 0.2)
    until = time.monotonic() + 60
    while not log.exists() and time.monotonic() < until:
        time.sleep(0.01)
    os.kill(sleeper.pid, signal.SIGSTOP)
    ended(started(tmp_path / "s", clips, log))
    check(tmp_path / "s", alone)
    os.kill(sleeper.pid, signal.SIGCONT)
    ended(sleeper)
    check(tmp_path / "s", alone)


def test_of_two_that_both_believe_in_their_claim_the_first_counts(tmp_path, clips, alone):
    both = [work(tmp_path / "s", clips) for _ in range(2)]

    class Believed:
        unit, take = 0, 1

        def require(self):
            pass

    assert both[0]._make(Believed(), "a", opened) and not both[1]._make(Believed(), "b", opened)
    both[1].run(opened)
    check(tmp_path / "s", alone)


def test_what_was_taken_out_is_made_again(tmp_path, clips, alone):
    store = FeatureStore(tmp_path / "alone")
    first = next(iter(store.entries()))["key"]
    assert store.drop(first) and not store.drop(first)
    assert first not in [entry["key"] for entry in store.entries()]
    again = work(tmp_path / "alone", clips).run(opened)
    assert again.here == 5 and again.entries == 1
    assert first in [entry["key"] for entry in FeatureStore(tmp_path / "alone").entries()]
    assert store.delete("cells") == 2 * CLIPS
    assert not [*store.entries()] and not [*tmp_path.glob("alone/shards/*/0*/entries.bin")]
    assert work(tmp_path / "alone", clips).run(opened).entries == 2 * CLIPS


def test_a_clip_that_cannot_be_taken_is_told_and_the_rest_is_there(tmp_path, clips, cells, capsys):  # noqa: F811
    (clips / "3.avi").write_bytes(b"no film")
    asked = ["extract", str(clips), "--out", str(tmp_path / "s"), "--encoder", "cells", "--shared"]
    weights = tmp_path / "w"
    weights.touch()
    assert main([*asked, "--weights", str(weights), "--quiet"]) == 1
    told = capsys.readouterr().out
    assert f"{clips / '3.avi'}: left out: " in told and "9 clips in 5 units, 5 of them" in told
    assert len([*FeatureStore(tmp_path / "s").entries()]) == CLIPS - 1
    assert main([*asked, "--weights", str(weights), "--fast"]) == 2
    assert main([*asked[:-1], "--weights", str(weights), "--lease", "3"]) == 2


def test_shards_lists_and_folders_are_sliced_without_reading_them(tmp_path, clips, monkeypatch):
    sets = tmp_path / "sets"
    sets.mkdir()
    for name in ("b.tar", "a.tar"):
        with tarfile.open(sets / name, "w") as archive:
            for number in range(3):
                data = (clips / f"{number}.avi").read_bytes()
                info = tarfile.TarInfo(f"{number}.avi")
                info.size = len(data)
                archive.addfile(info, io.BytesIO(data))
    listed = tmp_path / "some.txt"
    listed.write_text("clips/0.avi\n# no\nclips/4.avi\nclips/1.avi\n")
    to = tmp_path / "units"
    first = write_units([sets, listed, clips / "8.avi"], {}, to)
    units = Units(to)
    assert len(units) == 4
    assert units[0] == [sets / "a.tar" / str(n) for n in range(3)]
    assert units[2] == [clips / "0.avi", clips / "4.avi"]
    assert units[3] == [clips / "1.avi", clips / "8.avi"]
    assert write_units([sets, listed, clips / "8.avi"], {}, to) == first
    assert write_units([sets, listed, clips / "8.avi"], {"stride": 2}, to) != first
    os.utime(clips / "8.avi", (0, 0))
    assert write_units([sets, listed, clips / "8.avi"], {}, to) != first
    write_units([clips], {}, to)
    assert [clip for unit in Units(to) for clip in unit] == listed_clips([clips])
    with pytest.raises(InputError, match="no such file"):
        write_units([tmp_path / "none"], {}, to)
    outcome = work(tmp_path / "s", sets).run(opened)
    assert outcome.units == 2 and outcome.clips == 6
    assert len([*FeatureStore(tmp_path / "s").entries()]) == 6  # of three clips, each twice there
