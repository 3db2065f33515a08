"""Our fast paths beside their peers: the same work, interleaved, as ratios of medians."""

from __future__ import annotations

import multiprocessing
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

SETTLE = 0.03  # seconds between calls


@dataclass(frozen=True)
class Contender:
    """Something that is timed.

    Args:
        work: one call.
        amount: units of work in a call.
        path: what runs it, e.g. ``numba``.
    """

    work: Callable[[], Any]
    amount: float
    path: str


@dataclass(frozen=True)
class Match:
    """Ours against peers, by name, with the least ratio of speed that is asked for."""

    row: str
    unit: str
    ours: Contender
    peers: dict[str, tuple[Contender, float]]


@dataclass(frozen=True)
class BenchmarkRow:
    """Ours against one peer.

    Args:
        row, peer: names.
        unit: of the work.
        ours, theirs: units a second, medians.
        ratio: ours to theirs; ``low`` and ``high`` are quartiles over the rounds.
        bar: least ratio that is asked for (largest, for a deviation).
        reached: whether it is met.
        path: what ran ours.
        threads: of each contender.
        clock: ``cpu`` seconds of the process for one thread, else ``wall``.
        repeats: rounds.
        numbers: whatever else was measured.
    """

    row: str
    peer: str
    unit: str
    ours: float
    theirs: float
    ratio: float
    low: float
    high: float
    bar: float
    reached: bool
    path: str
    threads: int
    clock: str
    repeats: int
    numbers: dict[str, float] = field(default_factory=dict)


def run_benchmark(rows: Sequence[str], repeats: int, threads: int) -> list[BenchmarkRow]:
    """Measure rows, each in a fresh process that is held to ``threads`` cores.

    Args:
        rows: of :data:`ROWS`.
        repeats: interleaved rounds, at least 3.
        threads: 1 for one core.

    Raises:
        ValueError: an unknown row, or fewer than 3 repeats.
        ImportError: a peer is not installed (the extra ``bench``).
    """
    if unknown := [row for row in rows if row not in ROWS]:
        raise ValueError(f"benchmark: unknown row '{unknown[0]}'; known: {', '.join(ROWS)}")
    if repeats < 3:
        raise ValueError(f"benchmark: {repeats} repeats; quartiles need at least 3")
    found: list[BenchmarkRow] = []
    for row in rows:
        # Libraries take the number of cores from the process when they are first imported.
        with multiprocessing.get_context("spawn").Pool(1, _hold, (threads,)) as pool:
            found += pool.apply(_measure, (row, repeats, threads))
    return found


def _hold(threads: int) -> None:
    cores = sorted(os.sched_getaffinity(0))[-threads:]
    os.sched_setaffinity(0, cores)
    if threads == 1:
        os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
    import torch

    torch.set_num_threads(threads)


def _measure(row: str, repeats: int, threads: int) -> list[BenchmarkRow]:
    made = ROWS[row]()
    return [made] if isinstance(made, BenchmarkRow) else play(made, repeats, threads)


def play(match: Match, repeats: int, threads: int) -> list[BenchmarkRow]:
    """Time the contenders in turn, after one call of each that is not counted.

    A library that frees memory or winds up threads after its result is there does so in a pause,
    on its own account: the next contender would pay for it otherwise.
    """
    clock = time.process_time if threads == 1 else time.perf_counter
    contenders = [match.ours, *(peer for peer, _ in match.peers.values())]
    for one in contenders:
        one.work()
    speeds: list[list[float]] = [[] for _ in contenders]
    for _ in range(repeats):
        for one, found in zip(contenders, speeds, strict=True):
            began = clock()
            one.work()
            ended = clock()
            time.sleep(SETTLE)
            found.append(one.amount / ((clock() if threads == 1 else ended) - began))
    rows = []
    for (name, (_, bar)), theirs in zip(match.peers.items(), speeds[1:], strict=True):
        each = [a / b for a, b in zip(speeds[0], theirs, strict=True)]
        low, _, high = statistics.quantiles(each, n=4, method="inclusive")
        ours, peer = statistics.median(speeds[0]), statistics.median(theirs)
        rows.append(
            BenchmarkRow(
                row=match.row,
                peer=name,
                unit=match.unit,
                ours=ours,
                theirs=peer,
                ratio=ours / peer,
                low=low,
                high=high,
                bar=bar,
                reached=ours / peer >= bar,
                path=match.ours.path,
                threads=threads,
                clock="cpu" if threads == 1 else "wall",
                repeats=repeats,
            )
        )
    return rows


def _lies_in(module: str, row: str) -> Callable[[], Match | BenchmarkRow]:
    """A row of another file, which is imported where it is measured."""
    return lambda: import_module(f"benchmarks.{module}").ROWS[row]()


_DRAWN = ("forward", "backward", "kept")
_FILES = {
    "rollout_rows": (
        "compiled-factored",
        "compiled-radial",
        "network-factored",
        "network-factored-many",
        "network-unstructured",
    ),
    "deviation_rows": ("deviation-circular", "deviation-close"),
    "training_rows": ("training-step", "ten-seeds"),
    "renderer_rows": (
        *(f"{kind}-{how}" for kind in ("gaussians", "disks") for how in _DRAWN),
        "gaussians-bandwidth",
    ),
    "guard_rows": tuple(f"guards-{head}-{n}" for head in ("exact", "factored") for n in (1, 64)),
    "encoder_rows": ("dinov2", "dinov2-cached", "videomae", "videomae-cached"),
}
ROWS = {name: _lies_in(file, name) for file, names in _FILES.items() for name in names}


def table(rows: Sequence[BenchmarkRow]) -> str:
    """The rows as plain text, one a line."""
    lines = []
    for row in rows:
        verdict = "reached" if row.reached else "missed"
        extra = "".join(f"; {name} {value:.3g}" for name, value in row.numbers.items())
        lines.append(
            f"{row.row} | {row.peer} | {row.ours:.4g} against {row.theirs:.4g} {row.unit} | "
            f"{row.ratio:.3g} ({row.low:.3g} to {row.high:.3g}) | bar {row.bar:g}: {verdict} | "
            f"{row.path}, {row.threads} thread(s), {row.clock}{extra}"
        )
    return "\n".join(lines)
