"""One piece of work by us and by peers, timed side by side: ratios of medians, against a bar."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from vidphys.points.point import CPU_CLOCK, WALL_CLOCK
from vidphys.trade.timing import Timed, in_turn, quartiles

SETTLE = 0.03  # seconds between calls
BUILDING = "seconds to build"  # a number of a match: what ours takes before it is fast


@dataclass(frozen=True)
class Contender:
    """Something that is timed.

    Args:
        work: one call.
        amount: units of work in a call.
        path: what runs it, e.g. ``numba``.
        computes: what a unit of its work is, in words.
        excludes: what its user also waits for, and is not timed.
    """

    work: Callable[[], Any]
    amount: float
    path: str
    computes: str
    excludes: str = "nothing"


@dataclass(frozen=True)
class Match:
    """Ours against peers, by name, with the least ratio of speed that is asked for.

    Args:
        row, unit: names.
        ours: us.
        peers: and they.
        numbers: what else was measured of ours, its errors above all.
        replaces: the peer in whose place ours is built, where building takes seconds.
        wall: whether the wall clock counts whatever the threads: a card works, the processor waits.
    """

    row: str
    unit: str
    ours: Contender
    peers: dict[str, tuple[Contender, float]]
    numbers: dict[str, float] = field(default_factory=dict)
    replaces: str = ""
    wall: bool = False


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
        computes, peer_computes: what a unit of work is on either side.
        excludes, peer_excludes: what is not timed.
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
    computes: str = ""
    peer_computes: str = ""
    excludes: str = ""
    peer_excludes: str = ""
    numbers: dict[str, float] = field(default_factory=dict)


def play(match: Match, repeats: int, threads: int) -> list[BenchmarkRow]:
    """Time the contenders in turn, after one call of each that is not counted."""
    clock = CPU_CLOCK if threads == 1 and not match.wall else WALL_CLOCK
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
        _row(match, name, ours, speeds, threads, clock)
        for name, speeds in zip(match.peers, theirs, strict=True)
    ]


def _row(
    match: Match,
    peer: str,
    ours: list[float],
    theirs: list[float],
    threads: int,
    clock: str,
) -> BenchmarkRow:
    """The speeds of each round against one peer's."""
    them, bar = match.peers[peer]
    low, _, high = quartiles([a / b for a, b in zip(ours, theirs, strict=True)])
    mine, other = quartiles(ours)[1], quartiles(theirs)[1]
    numbers = dict(match.numbers)
    if peer == match.replaces and mine > other:
        numbers[f"{match.unit} until building pays"] = numbers[BUILDING] / (1 / other - 1 / mine)
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
        computes=match.ours.computes,
        peer_computes=them.computes,
        excludes=match.ours.excludes,
        peer_excludes=them.excludes,
        numbers=numbers,
    )


def table(rows: Sequence[BenchmarkRow]) -> str:
    """The rows as plain text, and under each what either side computes."""
    lines = []
    for row in rows:
        verdict = "reached" if row.reached else "missed"
        extra = "".join(f"; {name} {value:.3g}" for name, value in row.numbers.items())
        lines.append(
            f"{row.row} | {row.peer} | {row.ours:.4g} against {row.theirs:.4g} {row.unit} | "
            f"{row.ratio:.3g} ({row.low:.3g} to {row.high:.3g}) | bar {row.bar:g}: {verdict} | "
            f"{row.path}, {row.threads} thread(s), {row.clock}{extra}"
        )
        lines.append(f"    ours: {row.computes}; not timed: {row.excludes}")
        lines.append(f"    peer: {row.peer_computes}; not timed: {row.peer_excludes}")
    return "\n".join(lines)
