"""The figures of ``reproduce``: how far each number is from its bar, and drift along rollouts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from viz.figures import DRIFT_CAP, FAINT, INK, SPARE, STYLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GOOD, BAD = "#00664b", "#a33a00"
DECADES = 12  # a margin beyond this many decades is drawn at the edge


def margin_figure(rows: Sequence[Mapping[str, Any]]) -> Figure | None:
    """Each row with a bar: its value over the bar, so that the bars of all rows lie on one line.

    Args:
        rows: as in ``verdicts.json``. Rows without a number are named and have no mark; bars at
            zero cannot be divided by and are left out.

    Returns:
        The figure, or ``None`` if no row has a bar.
    """
    from matplotlib.figure import Figure

    held = [row for row in rows if row["row"]["bar"] and float(row["row"]["bar"].split()[1])]
    if not held:
        return None
    figure = Figure(figsize=(9.6, 0.9 + 0.27 * len(held)))
    axes = figure.subplots()
    for level, found in enumerate(held):
        _, bar = found["row"]["bar"].split()
        tone = GOOD if found["verdict"] == "met" else BAD
        for value in found["values"].values():
            axes.plot(_decades(value / float(bar)), level, "|", color=tone, ms=9, alpha=0.7)
        if found["value"] is None:
            axes.text(0, level, " no number", color=BAD, va="center", fontsize=8)
        else:
            ratio = _decades(found["value"] / float(bar))
            axes.plot(ratio, level, "o", color=tone, ms=6)
    axes.axvline(0, color=INK, lw=1)
    axes.set_yticks(range(len(held)), [_label(found["row"]) for found in held], fontsize=8)
    axes.set_ylim(len(held) - 0.4, -0.6)
    axes.set_xlabel("decades from the bar (0 is the bar; seeds as strokes)", color=INK)
    axes.grid(axis="x", color="#e6e9ec", lw=0.6)
    axes.spines[["top", "right", "left"]].set_visible(False)
    figure.tight_layout()
    return figure


def _decades(ratio: float) -> float:
    """log10 of a positive ratio, kept within the figure; other values lie at its left edge."""
    if not ratio > 0:
        return -DECADES
    return max(-DECADES, min(DECADES, math.log10(ratio)))


def _label(row: Mapping[str, Any]) -> str:
    what = row["what"] if len(row["what"]) < 70 else row["what"][:67] + "..."
    return f"{what}  ({row['bar']})"


def drift_curves(records: Sequence[Mapping[str, Any]]) -> Figure | None:
    """Median energy drift against steps, a line a cell, capped for display.

    Args:
        records: of one experiment. Cells with fewer than three horizons are left out, and so is
            the figure if none remains.
    """
    from matplotlib.figure import Figure

    curves = _curves(records)
    if not curves:
        return None
    figure = Figure(figsize=(8.6, 4.6))
    axes = figure.subplots()
    spare = 0
    for cell, points in curves.items():
        if cell in STYLES:
            colour, marker = STYLES[cell]
        else:
            colour, marker = SPARE[spare % len(SPARE)]
            spare += 1
        steps = sorted(points)
        values = [min(DRIFT_CAP, sum(points[s]) / len(points[s])) for s in steps]
        dashes = "-" if cell in STYLES else ("--", ":", "-.")[spare // len(SPARE) % 3]
        axes.plot(steps, values, dashes, color=colour, marker=marker, ms=5, lw=1.4, label=cell)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.axhline(DRIFT_CAP, color=FAINT, lw=0.8, ls=":")
    axes.set_xlabel("simulation steps")
    axes.set_ylabel("relative energy drift, median episode")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    figure.tight_layout()
    return figure


def _curves(records: Sequence[Mapping[str, Any]]) -> dict[str, dict[int, list[float]]]:
    """Cell -> steps -> values of the seeds that have one."""
    curves: dict[str, dict[int, list[float]]] = {}
    for record in records:
        if record["metric"] == "energy_drift_median" and record["value"]:
            points = curves.setdefault(record["cell"], {})
            points.setdefault(record["horizon"], []).append(record["value"])
    return {cell: points for cell, points in curves.items() if len(points) >= 3}
