"""One piece of work by us and by peers, timed side by side: ratios of medians, against a bar."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from vidphys.points.point import CPU_CLOCK, WALL_CLOCK
from vidphys.trade.timing import Timed, in_turn, quartiles

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


def play(match: Match, repeats: int, threads: int) -> list[BenchmarkRow]:
    """Time the contenders in turn, after one call of each that is not counted."""
    clock = CPU_CLOCK if threads == 1 else WALL_CLOCK
    contenders = [match.ours, *(peer for peer, _ in match.peers.values())]
    timed = [Timed(one.work) for one in contenders]
    for one in contenders:
        one.work()
    in_turn(timed, repeats, settle=SETTLE)
    ours, *theirs = (
        [one.amount / seconds for seconds in times.seconds(clock)]
        for one, times in zip(contenders, timed, strict=True)
    )
    return [
        _row(match, name, bar, ours, speeds, threads, clock)
        for (name, (_, bar)), speeds in zip(match.peers.items(), theirs, strict=True)
    ]


def _row(
    match: Match,
    peer: str,
    bar: float,
    ours: list[float],
    theirs: list[float],
    threads: int,
    clock: str,
) -> BenchmarkRow:
    """The speeds of each round against one peer's."""
    low, _, high = quartiles([a / b for a, b in zip(ours, theirs, strict=True)])
    mine, other = quartiles(ours)[1], quartiles(theirs)[1]
    return BenchmarkRow(
        row=match.row,
        peer=peer,
        unit=match.unit,
        ours=mine,
        theirs=other,
        ratio=mine / other,
        low=low,
        high=high,
        bar=bar,
        reached=mine / other >= bar,
        path=match.ours.path,
        threads=threads,
        clock=clock,
        repeats=len(ours),
    )


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
