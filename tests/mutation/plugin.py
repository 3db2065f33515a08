"""The two pytest sessions over a rewritten copy: one asks tolerances, one turns places round.

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
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import hypothesis
import mutation_probe as probe
import pytest
from _pytest.runner import runtestprotocol

# Seconds of the processor's time, which other work on the machine does not change: of a test that
# is used at all, of one that a mutant may have sent round in circles, of all tests of a mutant.
USED, STUCK, SPENT = 2.0, 10.0, 3.0
# Imported before the first child is forked: each would import them again, and an import that a
# test's limit breaks off leaves the tests after it a broken module.
WARM = ("torch._dynamo", "scipy.spatial", "mujoco", "numba", "dynamics.compiled.cpu")


class AskTolerances:
    """Runs all tests and leaves by how much the tolerances could be smaller."""

    def __init__(self, result: str, code: str) -> None:
        self.result, self.code = Path(result), code

    def pytest_sessionstart(self) -> None:
        same_examples()

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        found = {"code": self.code, "failed": session.testsfailed, "room": probe.room}
        self.result.write_text(json.dumps(found), encoding="utf-8")


def same_examples(**told: Any) -> None:
    """The same drawn examples in every run, so that a verdict does not depend on the draw."""
    hypothesis.settings.register_profile("mutation", derandomize=True, database=None, **told)
    hypothesis.settings.load_profile("mutation")


class TurnRound:
    """Runs, for each sign or decision, the tests that compute it, until one fails.

    Args:
        result: where a row for each sign is kept as soon as its verdict is known; those that are
            there already, of the same code, are not run again.
        places: file with what is told of each place.
        code: name of all code that is run.
    """

    def __init__(self, result: str, places: str, code: str) -> None:
        self.result, self.code = Path(result), code
        self.places = json.loads(Path(places).read_text(encoding="utf-8"))

    def pytest_sessionstart(self) -> None:
        # One failing example is enough; the smallest would take a hundred times as long.
        phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
        same_examples(phases=phases, report_multiple_bugs=False)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        for name in WARM:
            with suppress(ImportError):
                import_module(name)
        tests = {item.nodeid: item for item in session.items}
        rows, whole, found = self._kept(session.items)
        terms = [site for site in range(len(self.places)) if site not in whole]
        killers = Counter((row["file"], row["killer"]) for row in found)
        for site in terms[len(found) :]:
            place = self.places[site]
            covering = [row for row in rows if site in row["sites"]]
            # First the quick ones, and those that have found out others of the same file.
            kills = {row["name"]: killers[place["file"], row["name"]] for row in covering}
            covering.sort(key=lambda row: row["seconds"] / (1 + kills[row["name"]]))  # noqa: B023
            chosen = [row["name"] for row in _affordable(covering)]
            killer = self._killer(site, [tests[name] for name in chosen])
            killers[place["file"], killer] += 1
            found.append({**place, "tests": len(chosen), "killer": killer})
            self._keep(self.result, {"rows": found})
            print(f"\r{len(found)} of {len(terms)} places", end="", file=sys.stderr, flush=True)
        return True

    def _kept(self, items: list[pytest.Item]) -> tuple[list[Any], list[int], list[Any]]:
        """Tests and counts, see :func:`baseline`, and the rows of places that are known."""
        table = self.result.with_suffix(".baseline.json")
        if not self._known(table):
            in_child(lambda: self._keep(table, baseline(items)))
        if not self._known(self.result):
            self._keep(self.result, {"rows": []})
        tests, found = (json.loads(x.read_text(encoding="utf-8")) for x in (table, self.result))
        return tests["rows"], tests["whole"], found["rows"]

    def _known(self, file: Path) -> bool:
        return file.exists() and json.loads(file.read_text(encoding="utf-8"))["code"] == self.code

    def _keep(self, file: Path, what: dict[str, Any]) -> None:
        part = file.with_suffix(".part")  # a run that is stopped leaves the last whole file
        part.write_text(json.dumps({"code": self.code, **what}, indent=1), encoding="utf-8")
        part.replace(file)

    def _killer(self, site: int, tests: list[pytest.Item]) -> str:
        """The test that fails with a place turned round, or none; a crash is a failure too."""
        told = self.result.with_suffix(".killer")
        told.write_text("", encoding="utf-8")
        ended = in_child(lambda: mutant(site, tests, told)) if tests else True
        return told.read_text(encoding="utf-8") if ended else "a crash"


def baseline(items: list[pytest.Item]) -> dict[str, Any]:
    """How long each test takes, and which places it reaches; without the slow ones.

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
    return {"rows": rows, "whole": sorted(probe.whole - terms)}


def mutant(site: int, items: list[pytest.Item], told: Path) -> None:
    """Tell which test fails with this place turned round."""
    probe.active = site
    for item, after in _in_turn(items):
        if any(report.failed for report in _run(item, after, STUCK)):
            told.write_text(item.nodeid, encoding="utf-8")
            return


def in_child(work: Callable[[], Any]) -> bool:
    """Do the work in a copy of this process; whether the copy ended well."""
    child = os.fork()
    if not child:
        try:
            work()
            os._exit(0)
        finally:  # whatever it was, the copy must not go on as pytest
            traceback.print_exc(file=sys.__stderr__)
            os._exit(2)
    return os.waitpid(child, 0)[1] == 0


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
    signal.setitimer(signal.ITIMER_PROF, limit, 1.0)  # again, if an example is tried again
    try:
        return runtestprotocol(item, log=False, nextitem=after)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
