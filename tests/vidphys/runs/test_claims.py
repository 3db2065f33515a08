"""Claims: one owner at a time, what a dead one held is taken over, a sleeper knows that it lost."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import time

import pytest

from vidphys.errors import InputError
from vidphys.runs import claims as module
from vidphys.runs.claims import ClaimLost, Claims

LEASE = 1.2
fork = multiprocessing.get_context("fork")


def test_a_unit_has_one_owner_until_that_one_leaves(tmp_path):
    with Claims(tmp_path) as second:
        with Claims(tmp_path) as first:
            assert first.take(3).take == 1 and second.take(4).take == 1
            assert second.take(3) is None and first.take(4) is None
        claim = second.take(3)  # without a wait: its owner said that it leaves
        assert claim.take == 2
        claim.require()
    with pytest.raises(InputError, match="`lease` 0"):
        Claims(tmp_path, 0)


def test_of_many_at_once_one_takes_it(tmp_path):
    def takes(number, gate):
        with Claims(tmp_path) as claims:
            gate.wait(60)
            taken = [unit for unit in range(20) if claims.take(unit)]
            (tmp_path / f"{number}.txt").write_text(" ".join(map(str, taken)))
            gate.wait(60)

    gate = fork.Barrier(3)
    workers = [fork.Process(target=takes, args=(n, gate)) for n in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
    taken = [int(unit) for file in tmp_path.glob("*.txt") for unit in file.read_text().split()]
    assert sorted(taken) == list(range(20))


def _holds(folder, ready):
    with Claims(folder, LEASE) as claims:
        claim = claims.take(0)
        (folder / "slow").write_text("taken")
        ready.set()
        for _ in range(600):
            time.sleep(0.05)
            if not claim.held():
                (folder / "lost").write_text("lost")
                return


def until(what):
    end = time.monotonic() + 60
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture
def holder(tmp_path):
    ready = fork.Event()
    process = fork.Process(target=_holds, args=(tmp_path, ready))
    process.start()
    assert ready.wait(60)
    yield process
    process.kill()
    process.join()


def test_a_living_owner_keeps_it_and_a_killed_one_loses_it_after_its_lease(tmp_path, holder):
    with Claims(tmp_path, LEASE) as claims:
        until_then = time.monotonic() + 3 * LEASE
        while time.monotonic() < until_then:
            assert claims.take(0) is None
            time.sleep(0.05)
        holder.kill()
        killed = time.monotonic()
        until(lambda: claims.take(0))
        assert time.monotonic() - killed > LEASE / 2


def test_one_that_was_stopped_knows_that_it_lost_the_unit(tmp_path, holder):
    os.kill(holder.pid, signal.SIGSTOP)
    with Claims(tmp_path, LEASE) as claims:
        until(lambda: claims.take(0))
        os.kill(holder.pid, signal.SIGCONT)
        until((tmp_path / "lost").exists)
        assert claims.take(1).held()


def test_a_lease_that_was_not_renewed_is_lost_also_to_oneself(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "BEATS", 0.01)  # no beat of the thread in this test
    with Claims(tmp_path, LEASE) as claims:
        claim = claims.take(0)
        claim.require()
        time.sleep(1.2 * LEASE)
        with pytest.raises(ClaimLost, match="unit 0"):
            claim.require()
        again = claims.take(0)
        assert again.take == 2 and again.held() and not claim.held()


def test_a_claim_whose_owner_died_while_writing_it_is_watched_like_any(tmp_path):
    with Claims(tmp_path, LEASE) as claims:
        (tmp_path / "claims" / "000000.1").touch()
        assert claims.take(0) is None
        until(lambda: claims.take(0))


def test_each_unit_comes_once_and_those_of_others_when_they_are_left(tmp_path):
    done = set()
    with Claims(tmp_path, LEASE) as claims:
        with Claims(tmp_path, LEASE) as other:
            other.take(2)
            coming = claims.each(range(5), done.__contains__)
            for _ in range(4):
                done.add(next(coming).unit)
            assert done == {0, 1, 3, 4}
        done.add(next(coming).unit)
        assert [*coming] == [] and done == set(range(5))


def test_a_folder_that_is_gone_ends_the_wait(tmp_path):
    done = set()
    with Claims(tmp_path / "work", LEASE) as claims:
        coming = claims.each(range(2), done.__contains__)
        done.add(next(coming).unit)
        shutil.rmtree(tmp_path / "work")
        assert claims.take(7) is None
        with pytest.raises(InputError, match="was deleted"):
            next(coming)
        done.update(range(2))
        assert [*claims.each(range(2), done.__contains__)] == []
