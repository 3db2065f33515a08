"""Entries in shards: the same features, safe when a process is killed, and taken out again."""

from __future__ import annotations

import multiprocessing
import os
import sqlite3
from collections import Counter

import pytest
import torch

from encoders import shards as module
from encoders.store import FeatureStore, StaleFeatures
from tests.shared.stored import TIMES, fill, made, parts_of, put_together, request
from vidphys.cli import main


def files(store):
    return [*(store.folder / "entries").iterdir()]


@pytest.mark.parametrize("dtype", ["float32", "float16", "bfloat16"])
def test_a_packed_entry_is_the_one_that_was_written(tmp_path, dtype):
    store = FeatureStore(tmp_path)
    wanted = {n: request(n, dtype) for n in range(5)}
    for number, each in wanted.items():
        store.write(each, "clip.mp4", made(number))
    before = {number: store.read(each) for number, each in wanted.items()}
    listed = sorted(store.entries(), key=lambda entry: entry["key"])
    assert store.pack() == 5 and files(store) == [] and store.pack() == 0
    for again in (store, FeatureStore(tmp_path)):
        assert sorted(again.entries(), key=lambda entry: entry["key"]) == listed
        for number, each in wanted.items():
            found = again.read(each)
            assert again.has(each) and torch.equal(found.values, before[number].values)
            assert found.values.dtype == before[number].values.dtype
            assert torch.equal(found.times, TIMES) and found.stride == (12.0, 16.0)
            found.values.mul_(2)  # a reader's own copy: the shard stays as it is
        assert again.verify() == [] and not again.has(request(9))
    assert torch.equal(FeatureStore(tmp_path).read(wanted[0]).values, before[0].values)


def test_shards_end_at_their_size_and_a_later_pack_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "SHARD_BYTES", 700)
    monkeypatch.setattr(module, "AT_ONCE", 2)
    fill(tmp_path, range(4)).pack()
    fill(tmp_path, range(4, 7)).pack()
    store = FeatureStore(tmp_path)
    shards = sorted((tmp_path / "shards").glob("*.bin"))
    assert len(shards) > 2 and all(file.stat().st_size < 2000 for file in shards)
    assert all(torch.equal(store.read(request(n)).values, made(n).values) for n in range(7))


def test_one_that_was_made_again_counts_before_the_packed_one(tmp_path):
    fill(tmp_path, [1]).pack()
    store = FeatureStore(tmp_path)
    store.write(request(1), "clip.mp4", made(2))
    assert torch.equal(store.read(request(1)).values, made(2).values)
    assert len([*store.entries()]) == 1
    store.pack()
    assert torch.equal(store.read(request(1)).values, made(2).values)


@pytest.mark.parametrize("left", [None, 0, 1])
def test_what_lies_in_a_shard_that_is_lost_or_cut_short_is_made_again(tmp_path, left):
    fill(tmp_path, range(3)).pack()
    (shard,) = (tmp_path / "shards").glob("*.bin")
    if left is None:
        shard.unlink()
    else:
        os.truncate(shard, left and shard.stat().st_size - 1)
    store = FeatureStore(tmp_path)
    gone = [n for n in range(3) if not store.has(request(n))]
    assert len(gone) == len(store.verify()) == (1 if left else 3)
    for number in gone:
        store.write(request(number), "clip.mp4", made(number))
    for _ in range(2):
        assert store.verify() == [] and len([*store.entries()]) == 3
        assert all(torch.equal(store.read(request(n)).values, made(n).values) for n in range(3))
        store.pack()
        store = FeatureStore(tmp_path)


def test_a_changed_byte_of_a_shard_and_of_its_index_is_seen(tmp_path):
    fill(tmp_path, range(3)).pack()
    (shard,) = (tmp_path / "shards").glob("*.bin")
    whole = shard.read_bytes()
    for place in range(0, len(whole), 37):
        spoiled = bytearray(whole)
        spoiled[place] ^= 1
        shard.write_bytes(spoiled)
        for number in range(3):
            try:
                found = FeatureStore(tmp_path).read(request(number))
            except StaleFeatures as error:
                assert "\n" not in str(error) and "vidphys store delete" in str(error)
            else:
                assert torch.equal(found.values, made(number).values)
    shard.write_bytes(whole[:-8])
    with pytest.raises(StaleFeatures, match="missing or cut short|damaged"):
        [FeatureStore(tmp_path).read(request(n)) for n in range(3)]
    shard.write_bytes(whole)
    with sqlite3.connect(tmp_path / "shards" / "index.sqlite") as index:
        index.execute("UPDATE entries SET manifest = replace(manifest, '12.0', '13.0')")
    with pytest.raises(StaleFeatures, match="damaged or was edited"):
        FeatureStore(tmp_path).read(request(0))


@pytest.mark.parametrize("dies_at", range(4))
def test_a_pack_that_dies_loses_nothing(tmp_path, monkeypatch, dies_at):
    store, calls = fill(tmp_path, range(6)), []
    monkeypatch.setattr(module, "AT_ONCE", 2)
    with monkeypatch.context() as patch:

        def dies(file):
            calls.append(file)
            if len(calls) > dies_at:
                raise OSError("disk is full")

        patch.setattr(module, "synced", dies)
        if dies_at < 3:
            with pytest.raises(OSError, match="disk is full"):
                store.pack()
    for again in (FeatureStore(tmp_path), store):
        assert all(torch.equal(again.read(request(n)).values, made(n).values) for n in range(6))
    store.pack()
    assert files(store) == [] and store.verify() == [] and len([*store.entries()]) == 6


def _dies_in_a_commit(folder):
    index = sqlite3.connect(folder / "shards" / "index.sqlite")
    index.execute("PRAGMA cache_size = 1")  # so that the file is changed before the commit
    index.execute("DELETE FROM entries")
    rows = ((f"{n:064x}", 0, 0, 1, "x", "y", "z" * 2000) for n in range(200))
    index.executemany("INSERT INTO entries VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
    os._exit(0)


def test_what_a_killed_writer_left_in_the_index_is_taken_back(tmp_path):
    fill(tmp_path, range(3)).pack()
    worker = multiprocessing.get_context("fork").Process(target=_dies_in_a_commit, args=[tmp_path])
    worker.start()
    worker.join(60)
    assert (tmp_path / "shards" / "index.sqlite-journal").stat().st_size > 0
    store = FeatureStore(tmp_path)
    assert all(torch.equal(store.read(request(n)).values, made(n).values) for n in range(3))
    assert len([*store.entries()]) == 3


def test_a_damaged_entry_is_not_packed(tmp_path):
    store = fill(tmp_path, range(2))
    damaged = tmp_path / "entries" / f"{request(0).key}.entry"
    tensors, said = parts_of(damaged)
    put_together(damaged, tensors[:-1] + b"x", said)
    assert store.pack() == 1 and files(store) == [damaged]
    assert store.verify() == [request(0).key]


def test_an_encoder_is_taken_out_and_made_again(tmp_path):
    fill(tmp_path, range(3)).pack()
    fill(tmp_path, range(3), layer="4").pack()
    store = fill(tmp_path, [7])
    fill(tmp_path, [1], name="other")
    counts = Counter()
    for name, layer, count, _ in store.counts():
        counts[name, layer] += count
    assert counts == {("fake", "8"): 4, ("fake", "4"): 3, ("other", "8"): 1}
    assert store.delete("fake", "4") == 3 and store.delete("none") == 0
    assert not store.has(request(1, layer="4")) and store.has(request(1))
    assert store.delete("fake") == 4
    assert [entry["request"]["encoder"]["name"] for entry in store.entries()] == ["other"]
    assert not list((tmp_path / "shards").glob("*.bin"))  # nothing is left in any
    store.write(request(1), "clip.mp4", made(1))
    store.pack()
    assert torch.equal(store.read(request(1)).values, made(1).values)


def _writes(folder, first):
    store = FeatureStore(folder)
    for number in range(first, first + 8):
        store.write(request(number), "clip.mp4", made(number))
        store.pack(least=3)


def test_processes_that_write_and_pack_at_once_lose_nothing(tmp_path):
    spawn = multiprocessing.get_context("fork")
    workers = [spawn.Process(target=_writes, args=(tmp_path, 10 * k)) for k in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(120)
        assert worker.exitcode == 0
    store = FeatureStore(tmp_path)
    numbers = [10 * k + n for k in range(3) for n in range(8)]
    assert all(torch.equal(store.read(request(n)).values, made(n).values) for n in numbers)
    assert store.verify() == []


def test_the_verb(tmp_path, capsys):
    fill(tmp_path / "s", range(3))
    assert main(["store", "list", str(tmp_path / "s")]) == 0
    assert "fake, layer 8: 3 entries" in capsys.readouterr().out
    assert main(["store", "pack", str(tmp_path / "s")]) == 0
    assert "3 entries" in capsys.readouterr().out
    assert main(["store", "check", str(tmp_path / "s")]) == 0
    assert main(["store", "delete", str(tmp_path / "s")]) == 2
    assert main(["store", "list", str(tmp_path / "none")]) == 2
    assert "is no feature store" in capsys.readouterr().err
    key = request(1).key
    assert main(["store", "delete", str(tmp_path / "s"), "--key", key]) == 0
    assert not FeatureStore(tmp_path / "s").has(request(1))
    assert main(["store", "delete", str(tmp_path / "s"), "--key", key]) == 2
    assert "no entry" in capsys.readouterr().err
    assert main(["store", "delete", str(tmp_path / "s"), "--encoder", "fake"]) == 0
    assert "2 entries of fake were deleted" in capsys.readouterr().out


def test_one_that_hangs_at_work_is_told_after_a_while_and_changes_nothing(tmp_path, monkeypatch):
    store = fill(tmp_path, [1])
    store.pack()
    fill(tmp_path, [2])
    monkeypatch.setattr(module, "WAIT", 0.1)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with store.shards.alone():
        assert main(["store", "pack", str(tmp_path)]) == 2
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("name", ["lock", "000000.bin", "index.sqlite", "000001.bin"])
def test_nothing_is_written_through_a_link(tmp_path, name, capsys):
    fill(tmp_path / "store", [1]).pack()
    precious = tmp_path / "precious"
    precious.write_bytes(b"mine")
    (tmp_path / "store" / "shards" / name).unlink(missing_ok=True)
    (tmp_path / "store" / "shards" / name).symlink_to(precious)
    fill(tmp_path / "store", [2])
    assert main(["store", "pack", str(tmp_path / "store")]) == 2
    assert f"{name} is a link" in capsys.readouterr().err
    assert precious.read_bytes() == b"mine"
