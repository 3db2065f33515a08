"""Mutation test of physics and judgement: would the tests see it? ``python -m tests.mutation``.

Three kinds of mutants, in a copy of the tree: each tolerance of the physics' tests a hundredth as
large, which a test must no longer hold to, or it would not see a fault a hundred times as large as
what it measures; each force, energy and port term with its sign turned round; and each decision of
metrics, verdicts, perception and readouts turned round. The same command again goes on where it
was, as long as no source and no test has changed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

from tests.mutation.equivalent import reason_of, stale
from tests.mutation.rewrite import PROBE, Decisions, Place, Signs, Tolerances, rewritten

HOME = Path(__file__).resolve().parents[2]
PACKAGES = (
    "loops",
    "dynamics",
    "renderers",
    "encoders",
    "binders",
    "readouts",
    "viz",
    "vidphys",
    "tests",
)
PHYSICS = ["dynamics", "vidphys/scenes"]
NOT_RUN = ("cuda.py",)  # needs a device
COVERING = [
    "dynamics/test_heads.py",
    "dynamics/test_integrators.py",
    "dynamics/test_guards.py",
    "vidphys/experiments/test_contacts.py",
    "dynamics/test_compiled.py",
    "dynamics/test_unrolled_orbits.py",
    "dynamics/test_octaves.py",
    "vidphys/experiments/test_pair_families.py",
    "vidphys/test_coupling_power.py",
    "vidphys/experiments/test_dissipation.py",
    "vidphys/experiments/test_drive.py",
    "vidphys/experiments/test_engine.py",
    "vidphys/experiments/test_factorial.py",
    "vidphys/scenes/test_scenes.py",
    "dynamics/test_values_by_hand.py",
    "vidphys/experiments/test_thermostat.py",
    "dynamics/test_neighbours.py",
    "dynamics/test_walls.py",
    "renderers/test_renderers.py",
    "vidphys/test_metrics.py",
]
JUDGES = [
    "vidphys/metrics.py",
    "vidphys/statistics.py",
    "vidphys/experiments/core/bars.py",
    "vidphys/experiments/core/question.py",
    "vidphys/experiments/core/scoring.py",
    "vidphys/perception",
    "readouts",
]
JUDGED_BY = [
    "vidphys/test_metrics.py",
    "vidphys/test_statistics.py",
    "vidphys/experiments/test_verdicts.py",
    "vidphys/experiments/test_scoring.py",
    "vidphys/experiments/test_tables.py",
    "vidphys/perception",
    "binders/test_slots.py",
    "binders/test_tracker.py",
    "readouts",
]
HUNDREDTH = 2  # powers of ten
LEAST = 0.95  # share of mutants that must be killed
KILLED, SURVIVED, EQUIVALENT = "killed", "survived", "equivalent"


def main() -> int:
    """Run each kind and print the survivors and the shares.

    Returns:
        0, or 1 if fewer than ``LEAST`` of all mutants are killed.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/mutation.json"))
    parser.add_argument("--only", choices=("tolerance", "sign", "decision"), help="one kind")
    parser.add_argument("--tests", nargs="*", help="files below tests/, in place of the kind's")
    parser.add_argument("--sources", nargs="*", help="what is turned round, in place of the kind's")
    told = parser.parse_args()
    told.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    kept = told.out.resolve()
    if told.only in (None, Tolerances.kind):
        rows += tolerances(of(told.tests, COVERING), kept.with_suffix(".tolerances.json"))
    for kind, sources, tests in ((Signs, PHYSICS, COVERING), (Decisions, JUDGES, JUDGED_BY)):
        if told.only in (None, kind.kind):
            file = kept.with_suffix(f".{kind.kind}s.json")
            rows += turned(kind, of(told.tests, tests), told.sources or sources, file)
    told.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return 0 if report(rows) >= LEAST else 1


def of(told: list[str] | None, usual: list[str]) -> list[str]:
    """The files of tests, as pytest takes them."""
    return [f"tests/{name}" for name in told or usual]


def tolerances(files: list[str], kept: Path) -> list[dict[str, Any]]:
    """Each tolerance that is held to, a row each with its verdict, see :func:`report`."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        places, code = copied(copy, Tolerances, files)
        if not kept.exists() or json.loads(kept.read_text(encoding="utf-8"))["code"] != code:
            session(copy, f"AskTolerances({str(kept)!r}, {code!r})", files)
        found = json.loads(kept.read_text(encoding="utf-8"))
    if found["failed"]:
        raise SystemExit(f"error: tests fail before anything is changed: {found['failed']}")
    rows = []
    for number, place in enumerate(places):
        room = found["room"].get(str(number))
        if room is not None:  # else it is as tight as rounding
            verdict = KILLED if room < HUNDREDTH else SURVIVED
            rows.append({**asdict(place), "verdict": verdict, "room": room})
    return rows


def turned(
    kind: type[Signs | Decisions], files: list[str], sources: list[str], kept: Path
) -> list[dict[str, Any]]:
    """Each place turned round, a row each; they are in ``kept`` as soon as they are known.

    Raises:
        SystemExit: a place that is said to be equivalent is not there, or a test sees it.
    """
    with tempfile.TemporaryDirectory() as folder:
        copy, told = Path(folder), Path(folder) / "places.json"
        places, code = copied(copy, kind, sources)
        if gone := stale(places, sources):
            raise SystemExit(f"error: said to be equivalent, but not there: {gone}")
        told.write_text(json.dumps([asdict(place) for place in places]), encoding="utf-8")
        # Compiled, a function would keep the sign that it was first compiled with. The plugin
        # limits the processor's time itself.
        slow = {"NUMBA_DISABLE_JIT": "1"}
        plugin = f"TurnRound({str(kept)!r}, {str(told)!r}, {code!r})"
        session(copy, plugin, files, slow, "--timeout=0")
    rows = json.loads(kept.read_text(encoding="utf-8"))["rows"]
    return [judged(row) for row in rows]


def judged(row: dict[str, Any]) -> dict[str, Any]:
    """A place's row with its verdict.

    Raises:
        SystemExit: it is said to be equivalent, but a test sees it.
    """
    reason = reason_of(row["file"], row["function"], row["text"])
    if reason and row["killer"]:
        raise SystemExit(f"error: said to be equivalent, but {row['killer']} sees it: {row}")
    if reason:
        return {**row, "verdict": EQUIVALENT, "reason": reason}
    return {**row, "verdict": KILLED if row["killer"] else SURVIVED}


def copied(
    copy: Path, rewriter: type[Signs | Decisions | Tolerances], sources: list[str]
) -> tuple[list[Place], str]:
    """Write a copy of the tree in which all places of some sources ask the probe.

    Returns:
        The places, and a name of all code that is in the copy.
    """
    for name in PACKAGES:
        shutil.copytree(HOME / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(HOME / "pyproject.toml", copy)
    shutil.copy(Path(__file__).with_name("probe.py"), copy / f"{PROBE}.py")
    shutil.copy(Path(__file__).with_name("plugin.py"), copy / "mutation_plugin.py")
    places: list[Place] = []
    for name in sources:
        source = copy / name
        for path in sorted(source.rglob("*.py")) if source.is_dir() else [source]:
            if path.name not in NOT_RUN:
                file = str(path.relative_to(copy))
                text = rewritten(path.read_text(encoding="utf-8"), rewriter, file, places)
                path.write_text(text, encoding="utf-8")
    code = sha256()
    for path in sorted(copy.rglob("*.py")):
        code.update(str(path.relative_to(copy)).encode() + path.read_bytes())
    return places, code.hexdigest()


def session(
    copy: Path, plugin: str, files: list[str], told: dict[str, str] | None = None, *options: str
) -> None:
    """Run pytest over the copy with a plugin, which leaves what it finds in a file."""
    begin = f"import sys, pytest; from mutation_plugin import *; plugin = {plugin}; "
    begin += "sys.exit(pytest.main(sys.argv[1:], [plugin]))"
    # Types are not checked: a mutant must be found out by its numbers, and tests take half as long.
    usual = ["-q", "-p", "no:cacheprovider", "-o", "addopts=", "-W", "ignore", "--tb=native"]
    environment = {**os.environ, "PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1", **(told or {})}
    command = [sys.executable, "-c", begin, *usual, "--assert=plain", *options, *files]
    done = subprocess.run(command, cwd=copy, env=environment, check=False)
    if done.returncode > 1:  # 1: some tests have failed
        raise SystemExit(f"error: the tests broke down with exit status {done.returncode}")


def report(rows: list[dict[str, Any]]) -> float:
    """Print what was not killed and, for each kind and for all, the share that was.

    Equivalent mutants, which no test can see, are told and not counted.
    """
    for row in rows:
        where = f"{row['file']}:{row['line']}"
        if row["verdict"] == SURVIVED:
            spare = f" (1e-{row['room']} of it would do)" if "room" in row else ""
            print(f"{row['kind']} survived{spare}: {where} {row['function']}: {row['text'][:100]}")
        elif row["verdict"] == EQUIVALENT:
            print(f"{row['kind']} is equivalent: {where} {row['text'][:100]}: {row['reason']}")
    share = 0.0
    for kind in ("tolerance", "sign", "decision", "all"):
        of_kind = [r for r in rows if kind in (r["kind"], "all") and r["verdict"] != EQUIVALENT]
        killed = sum(row["verdict"] == KILLED for row in of_kind)
        share = killed / max(1, len(of_kind))
        print(f"{kind}: {killed} of {len(of_kind)} mutants killed ({100 * share:.1f} %)")
    return share


if __name__ == "__main__":
    sys.exit(main())
