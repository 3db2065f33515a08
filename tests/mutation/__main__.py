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
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.mutation.rewrite import PROBE, Place, Signs, Tolerances, rewritten

HOME = Path(__file__).resolve().parents[2]
PACKAGES = ("dynamics", "renderers", "encoders", "binders", "readouts", "viz", "vidphys", "tests")
PHYSICS = ["dynamics", "vidphys/scenes"]
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
    parser.add_argument("--sources", nargs="*", default=PHYSICS, help="whose signs are turned")
    told = parser.parse_args()
    told.out.parent.mkdir(parents=True, exist_ok=True)
    files = [f"tests/test_{name}.py" for name in told.tests]
    rows = []
    if told.only != "sign":
        rows += tolerances(files)
    if told.only != "tolerance":
        rows += signs(files, told.sources, told.out.with_suffix(".signs.json").resolve())
    told.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return 0 if report(rows) >= LEAST else 1


def tolerances(files: list[str]) -> list[dict[str, Any]]:
    """Each tolerance that is held to, a row each with its verdict, see :func:`report`."""
    with tempfile.TemporaryDirectory() as folder:
        copy, result = Path(folder), Path(folder) / "result.json"
        places = copied(copy, Tolerances, files)
        session(copy, f"AskTolerances({str(result)!r})", files)
        found = json.loads(result.read_text(encoding="utf-8"))
    if found["failed"]:
        raise SystemExit(f"error: tests fail before anything is changed: {found['failed']}")
    rows = []
    for number, place in enumerate(places):
        room = found["room"].get(str(number))
        if room is not None:  # else it is as tight as rounding
            verdict = KILLED if room < HUNDREDTH else SURVIVED
            rows.append({**asdict(place), "verdict": verdict, "room": room})
    return rows


def signs(files: list[str], sources: list[str], result: Path) -> list[dict[str, Any]]:
    """Each sign of a term, a row each; they are in ``result`` as soon as they are known."""
    with tempfile.TemporaryDirectory() as folder:
        copy, told = Path(folder), Path(folder) / "places.json"
        places = [asdict(place) for place in copied(copy, Signs, sources)]
        told.write_text(json.dumps(places), encoding="utf-8")
        # Compiled, a function would keep the sign that it was first compiled with. The plugin
        # limits the processor's time itself.
        slow = {"NUMBA_DISABLE_JIT": "1"}
        session(copy, f"TurnSigns({str(result)!r}, {str(told)!r})", files, slow, "--timeout=0")
    rows = json.loads(result.read_text(encoding="utf-8"))
    return [{**row, "verdict": KILLED if row["killer"] else SURVIVED} for row in rows]


def copied(copy: Path, rewriter: type[Signs | Tolerances], sources: list[str]) -> list[Place]:
    """Write a copy of the tree in which all places of some sources ask the probe; the places."""
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
    return places


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
