"""The figure of ``reproduce``: how far each number is from its bar."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from viz.figures import INK

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
