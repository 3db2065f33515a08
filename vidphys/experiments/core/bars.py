"""Pre-registered rows: the study's figure, our bar, and which recorded number is held to it.

They lie in ``bars/TABLE.toml``. Their hash stands in every run's record, so that a bar that
moved after a run is seen.
"""

from __future__ import annotations

import hashlib
import math
import operator
import statistics
import tomllib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from vidphys.summary import OK

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
    "median": statistics.median,
    "largest": max,
    "smallest": min,
}
MET, MISSED, REPORTED, ABSENT = "met", "missed", "reported", "no number"
UNASKED = "not asked for"  # the verdict on a row whose cell the run left out
SKIPPED = "skipped"  # the status of what this machine lacks the means for
ERRORS = ("error", "drift", "nmse", "gap", "growth", "residual", "rmse")  # of which less is better


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

    def flatters(self, above: bool) -> bool:
        """Whether episodes that are lost could help the bar.

        They cannot where it asks for a large error: what is left then understates it. So it is
        for the number itself (``above``) and a bar from below, and for the one that divides it
        and a bar from above.
        """
        kind = any(word in self.metric for word in ERRORS)
        return not (kind and self.bar.startswith(">" if above else "<"))


@dataclass(frozen=True)
class Verdict:
    """A row with what was measured.

    Args:
        row: what was asked.
        values: by seed, of those with a number.
        value: the seeds joined; ``None`` without a number.
        verdict: met, missed, reported, ``no number``, or ``not asked for``.
        why: what stands where the number should, or what happened to some seeds.
        remark: what is known of why a bar is missed, from ``remarks.toml``.
        lost: (lost, of how many) episodes by seed, where some gave no finite number; the seed's
            value is over the others.
        role: what the seeds are for.
        stale: whether the code has changed since a number of the row's cells was made.
    """

    row: Row
    values: dict[int, float]
    value: float | None
    verdict: str
    why: str = ""
    remark: str = ""
    lost: dict[int, tuple[int, int]] = field(default_factory=dict)
    role: str = ""
    stale: bool = False


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


@dataclass(frozen=True)
class _Reading:
    """What the records say of one seed.

    Args:
        value: ``None`` without a number.
        fault: why there is none.
        lost, of: episodes without a finite number, of how many; the number is over the others.
    """

    value: float | None
    fault: str = ""
    lost: int = 0
    of: int = 0


def judge(row: Row, records: Sequence[Mapping[str, Any]], seeds: Collection[int] = ()) -> Verdict:
    """Hold a table's records to one row.

    A bar is met only if every seed has a finite number, over one that is not zero where the row
    is a ratio, and no episode was lost where that flatters. Anything else is a miss that says
    why; no seed's number is replaced, or left out in silence.

    Args:
        row: what is asked.
        records: of the row's table.
        seeds: that the row's cell was asked for: one without a record is a miss. Others that
            have one are judged too.
    """
    above = _by_seed(row, row.cell, records)
    below = _by_seed(row, row.divided_by or "", records)
    readings: dict[int, _Reading] = {}
    why: dict[int, str] = {}
    for seed in sorted({*above, *(seeds or below)}):
        found = _read(above.get(seed, []))
        trouble = [found.fault or _told(found, row.flatters(above=True))]
        if row.divided_by is not None:
            under = _read(below.get(seed, []))
            found, fault = _divided(found, under)
            fault = fault or _told(under, row.flatters(above=False))
            trouble += [f"{row.divided_by}: {fault}" if fault else ""]
        readings[seed] = found
        if any(trouble):
            why[seed] = ", ".join(text for text in trouble if text)
    return _verdict(row, readings, why)


def _verdict(row: Row, readings: Mapping[int, _Reading], why: Mapping[int, str]) -> Verdict:
    values = {seed: found.value for seed, found in readings.items() if found.value is not None}
    lost = {seed: (found.lost, found.of) for seed, found in readings.items() if found.lost}
    value = OVER[row.over](list(values.values())) if values else None
    said = "; ".join(f"seed {seed}: {text}" for seed, text in why.items())
    if value is None and (not row.bar or all(r.fault == SKIPPED for r in readings.values())):
        return Verdict(row, {}, None, ABSENT, said or "not recorded")
    if not row.bar:
        return Verdict(row, values, value, REPORTED, said, lost=lost)
    met = value is not None and not why and row.holds(value)
    return Verdict(row, values, value, MET if met else MISSED, said, lost=lost)


def _by_seed(
    row: Row, cell: str, records: Sequence[Mapping[str, Any]]
) -> dict[int, list[Mapping[str, Any]]]:
    """The records that a row asks of a cell."""
    found: dict[int, list[Mapping[str, Any]]] = {}
    for record in records:
        if (
            record["cell"] == cell
            and record["metric"] == row.metric
            and record["coupling"] == row.coupling
            and record["horizon"] == row.horizon
            and (not row.readout or record["readout"] == row.readout)
        ):
            found.setdefault(record["seed"], []).append(record)
    return found


def _read(records: Sequence[Mapping[str, Any]]) -> _Reading:
    """The number of one seed; of several records the last, unless one of them failed."""
    if not records:
        return _Reading(None, "no record")
    lost = max(int(record.get("nonfinite") or 0) for record in records)
    of = max(int(record.get("episodes") or 0) for record in records)
    failed = [record["status"] for record in records if record["status"] != OK]
    value = records[-1]["value"]
    if failed:
        return _Reading(None, failed[0], lost, of)
    if value is None or not math.isfinite(value):
        return _Reading(None, f"its value is {value}", lost, of)
    return _Reading(float(value), "", lost, of)


def _divided(above: _Reading, below: _Reading) -> tuple[_Reading, str]:
    """The ratio of two numbers, and what is wrong with the second."""
    lost, of = max((above.lost, above.of), (below.lost, below.of))
    fault = below.fault or ("" if below.value else "zero, which divides nothing")
    if fault or above.value is None or below.value is None:
        return _Reading(None, above.fault or fault, lost, of), fault
    ratio = above.value / below.value
    if not math.isfinite(ratio):
        return _Reading(None, "", lost, of), f"so small that the ratio is {ratio}"
    return _Reading(ratio, "", lost, of), ""


def _told(found: _Reading, flatters: bool) -> str:
    return f"{found.lost} of {found.of} episodes lost" if found.lost and flatters else ""
