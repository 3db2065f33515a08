"""The report of ``stress``: a figure an axis, the reliability figures, and every cell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viz.figures import FAINT, INK, save_svg
from viz.page import inline_svg, read_verdicts, write_page
from viz.sweeps import plain_ticks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TONES = {
    "sound": "good",
    "warned": "dull",
    "refused": "dull",
    "skipped": "dull",
    "silently wrong": "bad",
    "met": "good",
    "met in part": "dull",
    "missed": "bad",
    "not measured": "dull",
}
MARKS = {  # verdict -> colour and marker, told apart without colour as well
    "sound": ("#009E73", "o"),
    "warned": ("#A87900", "^"),
    "refused": ("#0072B2", "s"),
    "silently wrong": ("#D55E00", "X"),
}
AXES = {
    "softening": "softening length (world units)",
    "mass ratio": "heavier mass over lighter mass",
    "scale": "factor of all coordinates",
    "origin": "distance from the origin (world units)",
    "time step": "time step (s)",
    "contact stiffness": "contact stiffness (force per world unit)",
    "coincidence": "distance between bodies (world units)",
    "friction": "friction in a step, rate times step",
    "temperature": "temperature (unit masses, k_B = 1)",
    "drive": "drive (per second)",
    "bodies": "number of bodies",
    "image size": "side of the picture (pixels)",
    "threads": "number of threads",
    "energy balance": "interval between frames (s)",
}
SIDE, ACROSS = 7, 110  # of a cell's square in the picture of all, pixels; squares in a line
FLOOR, CEILING = 1e-18, 1e6  # errors are drawn within; those without a number lie on top
Cells = Sequence[Mapping[str, Any]]


def write_stress_report(run: Path) -> Path:
    """Write ``report.html`` and ``figures/`` of a run folder from its two JSON files.

    Raises:
        ValueError: one of the two is missing or cannot be read.
    """
    about, found = read_verdicts(run)
    axes: dict[str, list[Mapping[str, Any]]] = {}
    for cell in found["cells"]:
        axes.setdefault(cell["axis"], []).append(cell)
    told = {
        "title": "At the extremes: sound, warned of, or refused",
        "lead": _lead(found),
        "tally": _tally(found["counts"]),
        "facts": (
            f"Preset {about['settings']['preset']}, {found['seconds']:.0f} seconds of one core, "
            f"code {about['code_version']}."
        ),
        "wrong": [
            {"mark": None, "name": cell["name"], "more": "", "why": _said(cell)}
            for cell in found["cells"]
            if cell["verdict"] == "silently wrong"
        ],
        "matrix": matrix(axes),
        "figures": [{**row, "tone": TONES[row["verdict"]]} for row in found["figures"]],
        "axes": [_axis(run, name, cells) for name, cells in axes.items()],
        "tones": TONES,
    }
    return write_page(run, "stress.html", told)


def _lead(found: Mapping[str, Any]) -> str:
    """The result in a sentence."""
    wrong, count = found["counts"].get("silently wrong", 0), len(found["cells"])
    if not wrong:
        return f"Nothing was silently wrong in {count:,} cells."
    return f"{wrong:,} of {count:,} cells {'was' if wrong == 1 else 'were'} silently wrong."


def _tally(counts: Mapping[str, int]) -> list[tuple[str, str]]:
    return [(f"{count} {verdict}", TONES[verdict]) for verdict, count in counts.items()]


def matrix(axes: Mapping[str, Cells]) -> dict[str, Any]:
    """All cells as a picture: a row of squares an axis, for ``templates/matrix.svg``."""
    rows, top = [], 0
    for name, cells in axes.items():
        paths: dict[str, str] = {}
        for k, cell in enumerate(cells):
            x, y = SIDE * (k % ACROSS), top + SIDE * (k // ACROSS)
            square = f"M{x} {y}h{SIDE - 1}v{SIDE - 1}h-{SIDE - 1}z"
            paths[cell["verdict"]] = paths.get(cell["verdict"], "") + square
        rows.append({"name": name, "y": top + SIDE, "count": len(cells), "paths": paths})
        top += SIDE * -(-len(cells) // ACROSS) + 7
    return {"rows": rows, "left": 170, "width": 170 + SIDE * ACROSS, "height": top + 4}


def _axis(run: Path, name: str, cells: Cells) -> dict[str, Any]:
    anchor = "".join(c for c in name if c.isalnum())
    drawn = [cell for cell in cells if cell["verdict"] in MARKS]
    picture = None
    if len({cell["value"] for cell in drawn}) > 1:  # at one place there is nothing to be seen along
        path = run / "figures" / f"stress-{anchor}.svg"
        save_svg(axis_figure(name, cells), path)
        text = path.read_text(encoding="utf-8")
        picture = inline_svg(text, f"Error against bound along {name}")
    counts = Counter(cell["verdict"] for cell in cells)
    return {"id": anchor, "name": name, "tally": _tally(counts), "figure": picture, "cells": cells}


def axis_figure(name: str, cells: Cells) -> Figure:
    """Error over bound along an axis: below the line is sound, what has no number lies on top.

    Args:
        name: of the axis.
        cells: as in ``verdicts.json``.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    axes = figure.subplots()
    places = [abs(cell["value"]) for cell in cells if cell["value"]]
    least = 0.2 * min(places, default=1.0)  # where what lies at zero is drawn
    for verdict, (colour, marker) in MARKS.items():
        drawn = [cell for cell in cells if cell["verdict"] == verdict]
        if drawn:
            x = [abs(cell["value"]) or least for cell in drawn]
            y = [_ratio(cell) for cell in drawn]
            axes.plot(x, y, marker, ls="", color=colour, ms=4, label=verdict, mew=0)
    axes.axhline(1.0, color=INK, lw=1)
    axes.set_xscale("log")
    axes.set_yscale("log")
    plain_ticks(axes, "x")
    axes.set_xlabel(in_words(name))
    axes.set_ylabel("error over its bound")
    axes.grid(color=FAINT, alpha=0.25, lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    if any(cell["value"] == 0 for cell in cells):
        axes.annotate("0", (least, 0), xycoords=("data", "axes fraction"), fontsize=8, ha="center")
    figure.legend(fontsize=8, loc="outside right upper", frameon=False)
    return figure


def in_words(name: str) -> str:
    """An axis in words, with its unit."""
    kind, _, own = name.rpartition(": ")
    told = AXES.get(own, own)
    return f"{kind}: {told}" if kind else told


def _ratio(cell: Mapping[str, Any]) -> float:
    if cell["error"] is None:
        return CEILING
    bound = cell["bound"] or 1.0
    return min(CEILING, max(FLOOR, cell["error"] / bound))


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.2g}"


def _said(cell: Mapping[str, Any]) -> str:
    return f"error {_number(cell['error'])}, bound {cell['bound']:.1g} {cell['said']}"
