"""The two pytest sessions over a rewritten copy: one asks tolerances, one turns signs round.

Each mutant of the second runs in a child that is forked when the tests have been collected, so
that nothing is imported twice and nothing that one mutant has cached is seen by the next.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mutation_probe as probe
import pytest
from _pytest.runner import runtestprotocol

# Seconds of the processor's time, which other work on the machine does not change: of a test that
# is used at all, of one that a mutant may have sent round in circles, of all tests of a mutant.
USED, STUCK, SPENT = 2.0, 8.0, 3.0


class AskTolerances:
    """Runs all tests and leaves by how much the tolerances could be smaller."""

    def __init__(self, result: Path) -> None:
        self.result = result

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        found = {"failed": session.testsfailed, "room": probe.room}
        self.result.write_text(json.dumps(found), encoding="utf-8")


class TurnSigns:
    """Runs, for each sign, the tests that compute it, until one fails."""

    def __init__(self, result: Path, places: int) -> None:
        self.result, self.places = result, places

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        tests = {item.nodeid: item for item in session.items}
        table = self.result.with_suffix(".baseline.json")
        in_child(lambda: table.write_text(json.dumps(baseline(session.items)), encoding="utf-8"))
        rows, whole = json.loads(table.read_text(encoding="utf-8"))
        found = {}
        for site in set(range(self.places)).difference(whole):
            covering = [row for row in rows if site in row["sites"]]
            covering.sort(key=lambda row: row["seconds"])
            chosen = [tests[row["name"]] for row in _affordable(covering)]
            killer = in_child(lambda: mutant(site, chosen)) if chosen else None  # noqa: B023
            found[site] = {"tests": len(chosen), "killed": bool(killer)}
            print(f"\r{site + 1} of {self.places} signs", end="", file=sys.stderr, flush=True)
        self.result.write_text(json.dumps({"failed": 0, "signs": found}), encoding="utf-8")
        return True


def baseline(items: list[pytest.Item]) -> tuple[list[dict[str, Any]], list[int]]:
    """How long each test takes, and which signs it computes; without the slow ones.

    Also the places that have turned out to be of counts and indices.
    """
    rows = []
    for item, after in _in_turn(items):
        probe.reached.clear()
        began = time.process_time()
        if all(report.passed for report in _run(item, after, USED)):
            seconds = time.process_time() - began
            sites = sorted(probe.reached)
            rows.append({"name": item.nodeid, "seconds": seconds, "sites": sites})
    terms = {site for row in rows for site in row["sites"]}
    return rows, sorted(probe.whole - terms)


def mutant(site: int, items: list[pytest.Item]) -> bool:
    """Whether some test fails with this sign turned round."""
    probe.active = site
    turns = _in_turn(items)
    return any(report.failed for item, after in turns for report in _run(item, after, STUCK))


def in_child(work: Callable[[], Any]) -> bool:
    """Do the work in a copy of this process; whether it came out as true, or the copy died."""
    child = os.fork()
    if not child:
        try:
            os._exit(int(bool(work())))
        finally:  # whatever it was, the copy must not go on as pytest
            traceback.print_exc(file=sys.__stderr__)
            os._exit(2)
    return os.waitpid(child, 0)[1] != 0


def _affordable(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    spent = 0.0
    for row in rows:
        spent += row["seconds"]
        if spent > SPENT:
            return
        yield row


def _in_turn(items: list[pytest.Item]) -> list[tuple[pytest.Item, pytest.Item | None]]:
    return list(zip(items, [*items[1:], None], strict=True))


def _run(item: pytest.Item, after: pytest.Item | None, limit: float) -> list[pytest.TestReport]:
    """A test's reports; it fails when it has taken ``limit`` seconds."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"{item.nodeid} took more than {limit:g} s")

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        return runtestprotocol(item, log=False, nextitem=after)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
