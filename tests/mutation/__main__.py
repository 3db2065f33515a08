"""Mutation test of the physics: would the tests notice? ``python -m tests.mutation``.

Two kinds of mutants, in a copy of the tree: each tolerance of the physics' tests a hundredth as
large, which a test must no longer hold to, or it would not see a fault a hundred times as large as
what it measures; and each force, energy and port term with its sign turned round.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.mutation.rewrite import PROBE, Place, Signs, Tolerances, rewritten

HOME = Path(__file__).resolve().parents[2]
PACKAGES = ("dynamics", "renderers", "encoders", "binders", "readouts", "viz", "vidphys", "tests")
PHYSICS = ("dynamics", "vidphys/scenes")
NOT_RUN = ("cuda.py",)  # needs a device
COVERING = [
    "dynamics",
    "integrators",
    "guards",
    "contacts",
    "compiled",
    "pair_families",
    "coupling_power",
    "dissipation",
    "drive",
    "engine",
    "factorial",
    "scenes",
    "thermostat",
    "neighbours",
    "renderers",
    "metrics",
]
HUNDREDTH = 2  # powers of ten
LEAST = 0.95  # share of mutants that must be killed
KILLED, SURVIVED = "killed", "survived"


def main() -> int:
    """Run both kinds and print the survivors and the shares.

    Returns:
        0, or 1 if fewer than ``LEAST`` of all mutants are killed.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/mutation.json"))
    parser.add_argument("--only", choices=("tolerance", "sign"), help="one kind of mutants")
    parser.add_argument("--tests", nargs="*", default=COVERING, help="names without test_ and .py")
    told = parser.parse_args()
    rows = []
    for kind in ("tolerance", "sign"):
        if told.only in (None, kind):
            rows += run(kind, told.tests)
    told.out.parent.mkdir(parents=True, exist_ok=True)
    told.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return 0 if report(rows) >= LEAST else 1


def run(kind: str, tests: Iterable[str]) -> list[dict[str, Any]]:
    """Mutants of a kind, a row each with its verdict, see :func:`report`."""
    files = [f"tests/test_{name}.py" for name in tests]
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        places = copied(copy, kind, files)
        found = session(copy, kind, len(places), files)
    if found["failed"]:
        raise SystemExit(f"error: tests fail before anything is changed: {found['failed']}")
    return [row for i, place in enumerate(places) if (row := judged(kind, i, place, found))]


def copied(copy: Path, kind: str, files: list[str]) -> list[Place]:
    """Write a copy of the tree in which all places of a kind ask the probe; the places."""
    for name in PACKAGES:
        shutil.copytree(HOME / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(HOME / "pyproject.toml", copy)
    shutil.copy(Path(__file__).with_name("probe.py"), copy / f"{PROBE}.py")
    shutil.copy(Path(__file__).with_name("plugin.py"), copy / "mutation_plugin.py")
    places: list[Place] = []
    sources = [copy / file for file in files]
    if kind == "sign":
        sources = [f for name in PHYSICS for f in sorted((copy / name).rglob("*.py"))]
    for path in sources:
        if path.name not in NOT_RUN:
            file = str(path.relative_to(copy))
            rewriter = Signs if kind == "sign" else Tolerances
            text = rewritten(path.read_text(encoding="utf-8"), rewriter, file, places)
            path.write_text(text, encoding="utf-8")
    return places


def session(copy: Path, kind: str, places: int, files: list[str]) -> dict[str, Any]:
    """Run pytest over the copy, and read what it leaves."""
    result = copy / "result.json"
    begin = (
        "import sys, pytest; from pathlib import Path; import mutation_plugin as m; "
        f"result = Path({str(result)!r}); "
        f"plugin = m.TurnSigns(result, {places}) if {kind == 'sign'} else m.AskTolerances(result); "
        "sys.exit(pytest.main(sys.argv[1:], [plugin]))"
    )
    # Types are not checked: a mutant must be found out by its numbers, and tests take half as long.
    options = ["-q", "-p", "no:cacheprovider", "-o", "addopts=", "-W", "ignore", "--tb=short"]
    environment = {**os.environ, "PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1"}
    if kind == "sign":
        # Compiled, a function would keep the sign that it was first compiled with.
        environment["NUMBA_DISABLE_JIT"] = "1"
        options.append("--timeout=0")  # the plugin has its own, of the processor's time
    command = [sys.executable, "-c", begin, *options, *files]
    done = subprocess.run(command, cwd=copy, env=environment, check=False)
    if not result.exists():
        raise SystemExit(f"error: the {kind} session broke down with exit status {done.returncode}")
    return json.loads(result.read_text(encoding="utf-8"))


def judged(kind: str, number: int, place: Place, found: dict[str, Any]) -> dict[str, Any] | None:
    """A mutant's row; none for what is none: a count's sign, a tolerance as tight as rounding."""
    if kind == "tolerance":
        room = found["room"].get(str(number))
        verdict = KILLED if room is not None and room < HUNDREDTH else SURVIVED
        return None if room is None else {**asdict(place), "verdict": verdict, "room": room}
    sign = found["signs"].get(str(number))
    if sign is None:
        return None
    verdict = KILLED if sign["killed"] else SURVIVED
    return {**asdict(place), "verdict": verdict, "tests": sign["tests"]}


def report(rows: list[dict[str, Any]]) -> float:
    """Print the survivors and, for each kind and for all, the share that was killed."""
    for row in rows:
        if row["verdict"] == SURVIVED:
            where = f"{row['file']}:{row['line']}"
            spare = f" (1e-{row['room']} of it would do)" if "room" in row else ""
            print(f"{row['kind']} survived{spare}: {where} {row['function']}: {row['text'][:100]}")
    share = 0.0
    for kind in ("tolerance", "sign", "all"):
        of_kind = [row for row in rows if kind in (row["kind"], "all")]
        killed = sum(row["verdict"] == KILLED for row in of_kind)
        share = killed / max(1, len(of_kind))
        print(f"{kind}: {killed} of {len(of_kind)} mutants killed ({100 * share:.1f} %)")
    return share


if __name__ == "__main__":
    sys.exit(main())
