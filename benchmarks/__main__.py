"""``python -m benchmarks``, from a checkout: each row is printed and kept as it is measured."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from benchmarks.benchmark import CARD_ROWS, ROWS, run_benchmark
from benchmarks.match import table
from vidphys.cli.console import Console
from vidphys.devices import prepare_device
from vidphys.errors import InputError
from vidphys.runs.atomic import write_json
from vidphys.runs.code import code_version
from vidphys.trade.session import surroundings

REPEATS = {"quick": 3, "standard": 7}


@dataclass(frozen=True)
class BenchmarkConfig:
    """Time the fast paths against their peers, side by side.

    Example: python -m benchmarks --rows compiled-factored disks-forward --preset standard

    Args:
        rows: what is measured; all if none is named.
        threads: cores of each contender; with 1 the time of the process counts, else the wall
            clock.
        device: cuda measures the rows of a card, all by the wall clock.
        preset: quick takes the median of 3 rounds, standard of 7.
        out: folder of benchmark.json. The same command again goes on where it was.
        overwrite: give up what lies there.
        quiet: print nothing but the rows.
    """

    rows: tuple[str, ...] = ()
    threads: int = 1
    device: Literal["cpu", "cuda"] = "cpu"
    preset: Literal["quick", "standard"] = "quick"
    out: Path = Path("runs/benchmark")
    overwrite: bool = False
    quiet: bool = False


def run(config: BenchmarkConfig) -> None:
    """Measure the rows that are not kept yet.

    Raises:
        InputError: an unknown row, no threads, no card, or rows in the folder that were measured in
            other surroundings.
    """
    prepare_device(config.device)
    rows_there = CARD_ROWS if config.device == "cuda" else ROWS
    for row in config.rows:
        if row not in rows_there:
            raise InputError(f"--rows {row}: no such row; there are {', '.join(rows_there)}")
    if config.threads < 1:
        raise InputError(f"--threads {config.threads}: at least one is needed")
    names, repeats = config.rows or tuple(rows_there), REPEATS[config.preset]
    about = {"code_version": code_version(), "repeats": repeats, **surroundings(config.device)}
    about["threads"] = config.threads  # of the rows' processes, not of this one
    path = config.out / "benchmark.json"
    kept = _kept(path, about, config.overwrite)
    with Console(config.quiet, len(names), "benchmark") as console:
        for number, name in enumerate(names):
            if name not in kept["rows"]:
                try:
                    rows = run_benchmark(name, repeats, config.threads, config.device)
                except ImportError as error:
                    kept["skipped"][name] = f"{error}; pip install 'vidphys[bench]'"
                    console.warn(f"{name} skipped: {kept['skipped'][name]}")
                    continue
                kept["rows"][name] = [asdict(row) for row in rows]
                kept["skipped"].pop(name, None)
                write_json(path, kept)
                console.result(table(rows))
            console.done(number)
    found = [row for name in names for row in kept["rows"].get(name, ())]
    missed = sum(not row["reached"] for row in found)
    console.result(f"{len(found)} rows, {missed} below their bar; {path}")


def _kept(path: Path, about: dict[str, Any], overwrite: bool) -> dict[str, Any]:
    """What an interrupted benchmark has measured in the same surroundings; else nothing."""
    if overwrite or not path.is_file():
        return {"surroundings": about, "rows": {}, "skipped": {}}
    kept = json.loads(path.read_text(encoding="utf-8"))
    if kept["surroundings"] != about:
        raise InputError(
            f"{path}: measured in other surroundings; use another --out, or --overwrite"
        )
    return kept


def main(arguments: list[str] | None = None) -> int:
    """0: measured. 2: wrong input, said in a line. 130: interrupted, the rows so far kept."""
    config = tyro.cli(BenchmarkConfig, args=arguments, prog="python -m benchmarks")
    try:
        run(config)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
