"""Pre-registered rows: the study's figure, our bar, and which recorded number is held to it.

They lie in ``bars/TABLE.toml``. Their hash stands in every run's record, so that a bar that
moved after a run is seen.
"""

from __future__ import annotations

import hashlib
import operator
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from vidphys.metrics import OK

FOLDER = Path(__file__).parents[1] / "bars"
REMARKS = Path(__file__).parents[1] / "remarks.toml"
COMPARE: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
OVER: dict[str, Callable[[Sequence[float]], float]] = {
    "mean": lambda x: sum(x) / len(x),
    "median": lambda x: sorted(x)[len(x) // 2],
    "largest": max,
    "smallest": min,
}
MET, MISSED, REPORTED, ABSENT = "met", "missed", "reported", "no number"


@dataclass(frozen=True)
class Row:
    """One line of a table's report.

    Args:
        id: of the study's result, for example ``N16``.
        what: in words.
        cell, metric, coupling, horizon: which records.
        readout: which of a cell's records, where it has several readouts.
        over: how seeds are joined: mean, median, largest or smallest.
        divided_by: a cell whose value divides this one's, seed by seed; for patterns.
        paper: the study's figure as it stands there, or empty.
        bar: for example ``<= 2e-5``, or empty where the row only reports.
        evidence: the study's class of the claim: WS, D, Su, B or PN.
    """

    id: str
    what: str
    cell: str
    metric: str
    coupling: float | None = None
    horizon: int | None = None
    over: str = "mean"
    divided_by: str | None = None
    paper: str = ""
    bar: str = ""
    evidence: str = ""
    readout: str = ""

    def holds(self, value: float) -> bool:
        """Whether a value meets the bar."""
        sign, number = self.bar.split()
        return COMPARE[sign](value, float(number))


@dataclass(frozen=True)
class Verdict:
    """A row with what was measured.

    Args:
        row: what was asked.
        values: by seed, of those with a number.
        value: the seeds joined; ``None`` without a number.
        verdict: met, missed, reported, or ``no number``.
        why: what stands where the number should, or what happened to some seeds.
        remark: what is known of why a bar is missed, from ``remarks.toml``.
    """

    row: Row
    values: dict[int, float]
    value: float | None
    verdict: str
    why: str = ""
    remark: str = ""


def rows_of(table: str) -> tuple[Row, ...]:
    """The rows of a table.

    Raises:
        ValueError: a key or a bar that is not understood, with file and row.
    """
    path = FOLDER / f"{table}.toml"
    if not path.exists():
        return ()
    known = {f.name for f in fields(Row)}
    rows = []
    for entry in tomllib.loads(path.read_text(encoding="utf-8"))["row"]:
        unknown = set(entry) - known
        if unknown:
            raise ValueError(f"{path.name}: row {entry.get('id')}: unknown {sorted(unknown)}")
        row = Row(**entry)
        if row.over not in OVER or (row.bar and row.bar.split()[0] not in COMPARE):
            raise ValueError(f"{path.name}: row {row.id}: over '{row.over}', bar '{row.bar}'")
        rows.append(row)
    return tuple(rows)


def with_remark(table: str, verdict: Verdict) -> Verdict:
    """A missed row with what is known of the reason; others as they are.

    Remarks are written after runs and are no part of the bars or of their hash.
    """
    if verdict.verdict in (MET, REPORTED):
        return verdict
    remarks = tomllib.loads(REMARKS.read_text(encoding="utf-8")).get(table, {})
    return replace(verdict, remark=remarks.get(verdict.row.what, ""))


def bars_hash(tables: Iterable[str]) -> str:
    """SHA-256 over the tables' files of bars, in the order of their names."""
    digest = hashlib.sha256()
    for path in sorted(FOLDER / f"{table}.toml" for table in tables):
        if path.exists():
            digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def judge(row: Row, records: Sequence[Mapping[str, Any]]) -> Verdict:
    """Hold a table's records to one row.

    A seed whose number is missing or failed is named and never replaced; a bar is met only if
    every recorded seed has a number.
    """
    values, lost = _values(row, row.cell, records)
    if row.divided_by is not None:
        below, lost_below = _values(row, row.divided_by, records)
        both = [s for s in values if s in below and below[s] != 0]
        values, lost = {s: values[s] / below[s] for s in both}, {**lost, **lost_below}
    why = "; ".join(f"seed {seed}: {status}" for seed, status in sorted(lost.items()))
    if not values:
        return Verdict(row, {}, None, ABSENT, why or "not recorded")
    value = OVER[row.over](list(values.values()))
    if not row.bar:
        return Verdict(row, values, value, REPORTED, why)
    return Verdict(row, values, value, MET if row.holds(value) and not lost else MISSED, why)


def _values(
    row: Row, cell: str, records: Sequence[Mapping[str, Any]]
) -> tuple[dict[int, float], dict[int, str]]:
    values, lost = {}, {}
    for record in records:
        same = (
            record["cell"] == cell
            and record["metric"] == row.metric
            and record["coupling"] == row.coupling
            and record["horizon"] == row.horizon
            and (not row.readout or record["readout"] == row.readout)
        )
        if same and record["status"] == OK:
            values[record["seed"]] = record["value"]
        elif same:
            lost[record["seed"]] = record["status"]
    return values, lost
