"""Several runs of the ladder beside each other: what has changed first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from viz.cells import NOT_MEASURED, mean_cell
from viz.page import write_page
from viz.report import read_run
from viz.roles import by_role
from viz.sentences import law, verdicts
from viz.summary import Line, Records
from viz.tables import TONES

WIDTH, LEFT, RIGHT, STEP = 900, 330, 20, 22  # of the figure, CSS pixels; STEP a line
NUDGE = 3  # up or down, so that equal numbers are both seen


def write_comparison(runs: Sequence[Path], folder: Path) -> Path:
    """Write ``comparison.html`` into a folder.

    Args:
        runs: folders of ladders, two or more, with different names or places.
        folder: where to.

    Raises:
        ValueError: a run cannot be read, has no ladder, or the runs ask different laws.
    """
    found = [by_role(read_run(run)[1])[0] for run in runs]
    couplings = {records.coupling for records in found}
    if len(couplings) != 1 or None in couplings:
        raise ValueError("report: only ladders that ask the same law can be compared")
    names = _names(runs)
    told = [{line: word for line, word, _ in verdicts(records)} for records in found]
    lines = list(dict.fromkeys(line for records in found for line in records.lines))
    rows = [_row(line, found, told) for line in lines]
    rows.sort(key=lambda row: (not row["changed"], -row["apart"]))
    changed = [row["name"] for row in rows if row["changed"]]
    shown = ", ".join(changed[:4]) + (f" and {len(changed) - 4} more" if len(changed) > 4 else "")
    return write_page(
        folder,
        "comparison.html",
        {
            "title": "Runs beside each other",
            "asked": f"{len(runs)} runs were asked how bodies move under {law(found[0].coupling)}.",
            "said": f"{len(changed)} verdicts differ: {shown}."
            if changed
            else "No verdict differs.",
            "names": names,
            "rows": rows,
            "picture": _picture(rows),
        },
        "comparison.html",
    )


def _names(runs: Sequence[Path]) -> list[str]:
    """Of the folders; with the folder above where two share a name."""
    short = [run.resolve().name for run in runs]
    if len(set(short)) == len(short):
        return short
    return ["/".join(run.resolve().parts[-2:]) for run in runs]


def _row(line: Line, found: Sequence[Records], told: Sequence[dict[Line, str]]) -> dict[str, Any]:
    errors = [records.pick(line, "inversion_nmse", coupling=records.coupling) for records in found]
    words = [verdict.get(line) for verdict in told]
    means = [error.mean if error else None for error in errors]
    logs = [math.log10(x) for x in means if x]
    present = {word for word in words if word is not None}
    return {
        "name": f"{line.rung} / {line.head}",
        "cells": [NOT_MEASURED if error is None else mean_cell(error) for error in errors],
        "marks": [None if word is None else (word, TONES[word]) for word in words],
        "means": means,
        "apart": max(logs) - min(logs) if len(logs) > 1 else 0.0,
        "changed": len(present) > 1,
    }


def _picture(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Where each error stands on one logarithmic axis, a line a model."""
    values = [x for row in rows for x in row["means"] if x]
    low = math.floor(math.log10(min(values))) if values else -1
    high = max(math.ceil(math.log10(max(values))) if values else 0, low + 1)
    width = WIDTH - LEFT - RIGHT

    def place(value: float) -> float:
        return round(LEFT + width * (math.log10(value) - low) / (high - low), 1)

    lines = [
        {
            "name": row["name"],
            "changed": row["changed"],
            "y": 14 + STEP * k,
            "dots": [
                None if not x else (place(x), 14 + STEP * k + NUDGE * (2 * (n % 2) - 1))
                for n, x in enumerate(row["means"])
            ],
        }
        for k, row in enumerate(rows)
    ]
    ticks = [(place(10.0**k), f"1e{k}") for k in range(low, high + 1)]
    foot = STEP * len(rows) + 6
    return {
        "lines": lines,
        "ticks": ticks,
        "width": WIDTH,
        "foot": foot,
        "height": foot + 22,
        "left": LEFT - 10,
    }
