"""The first figure of the ladder's report: each rung's head beside its twin, and the study.

The study reads momentum by differencing; where another reading is shown, our head under that one
stands beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from viz.cells import number
from viz.sentences import law
from viz.summary import SKILL_BAR, TWIN, Line, Records

WIDTH, LEFT, RIGHT = 600, 158, 22  # of the drawing, and of its least margins; CSS pixels
LETTER = 8.3  # of a name, as wide as a phone shows it
TOP, BOTTOM = 26, 34
HIGHEST, LOWEST = 22, 11  # of a row
ROOM = 330  # that rows take together, where they can
HEAD = "factored"
READINGS = ("shooting", "none", "differencing")  # of several, the first is drawn


def headline(records: Records, references: Mapping[str, float]) -> dict[str, Any] | None:
    """Where everything stands, for ``templates/headline.svg``; nothing if nothing inverts.

    Args:
        records: of a ladder.
        references: the study's errors by cell.
    """
    shown = [(lines, pair) for lines in _rungs(records) if (pair := _pair(lines))]
    found = [_row(records, *pair, _differenced(lines), references) for lines, pair in shown]
    values = [x for row in found for x in row["values"] if x > 0]
    if not values:
        return None
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    high = max(high, low + 1)
    left = max(LEFT, round(LETTER * max(len(row["name"]) for row in found)) + 16)
    width, step = WIDTH - left - RIGHT, max(1, -(-(high - low) // 6))

    def place(value: float) -> float:
        power = math.log10(value) if value > 0 else low
        return round(left + width * (min(max(power, low), high) - low) / (high - low), 1)

    height = max(LOWEST, min(HIGHEST, ROOM // len(found)))
    rows = []
    for k, row in enumerate(found):
        dots = [{**dot, "x": place(dot["value"])} for dot in row["dots"]]
        line = None if row["bar"] is None else place(row["bar"])
        rows.append({**row, "dots": dots, "pass": line, "y": TOP + height * (k + 0.5)})
    return {
        "rows": rows,
        "height": height,
        "width": WIDTH,
        "left": left,
        "right": WIDTH - RIGHT,
        "top": TOP,
        "foot": TOP + height * len(rows),
        "whole": TOP + height * len(rows) + BOTTOM,
        "ticks": [(place(10.0**k), _power(k)) for k in range(low, high + 1, step)],
        "law": law(records.coupling),
        "kinds": {dot["kind"] for row in rows for dot in row["dots"]},
    }


def _power(exponent: int) -> str:
    return {0: "1", 1: "10", -1: "0.1", -2: "0.01"}.get(exponent, f"1e{exponent}")


def _rungs(records: Records) -> list[list[Line]]:
    """The lines of each grounding."""
    rungs: dict[str, list[Line]] = {}
    for line in records.lines:
        rungs.setdefault(line.grounding, []).append(line)
    return list(rungs.values())


def _pair(lines: Sequence[Line]) -> tuple[Line, Line | None] | None:
    """The head of one reading that is shown of a rung, and its twin."""
    for reading in READINGS:
        mine = {line.head: line for line in lines if line.readout == reading}
        if HEAD in mine:
            return mine[HEAD], mine.get(TWIN)
    return None


def _differenced(lines: Sequence[Line]) -> Line | None:
    """The head that reads momentum as the study does."""
    return next((x for x in lines if (x.head, x.readout) == (HEAD, "differencing")), None)


def _row(
    records: Records,
    head: Line,
    twin: Line | None,
    beside: Line | None,
    references: Mapping[str, float],
) -> dict[str, Any]:
    dots, lost = [], ""
    study = references.get(f"{head.grounding}/{head.head}")
    beside = None if study is None or beside is head else beside
    for line, kind in ((twin, "twin"), (beside, "beside"), (head, "head")):
        error = records.pick(line, "inversion_nmse", coupling=records.coupling) if line else None
        if line is None or error is None:
            continue
        if error.mean is None:
            lost = f"{line.head}: {error.words}"
            continue
        dots.append(_dot(kind, line, error.mean, f"{line.rung}, {line.head}"))
    if study is not None:
        dots.append(_dot("study", head, study, f"{head.grounding}, the study"))
    floor = records.pick(head, "ballistic_nmse", coupling=records.coupling)
    bar = SKILL_BAR * floor.mean if floor and floor.mean else None
    values = [dot["value"] for dot in dots] + ([bar] if bar else [])
    return {"name": head.grounding, "dots": dots, "bar": bar, "values": values, "lost": lost}


def _dot(kind: str, line: Line, value: float, name: str) -> dict[str, Any]:
    return {
        "kind": kind,
        "cell": f"{line.grounding}/{line.head}",
        "readout": line.readout,
        "value": value,
        "name": f"{name}: {number(value)}",
    }
