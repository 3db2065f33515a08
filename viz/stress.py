"""The report of ``stress``: a figure an axis, the reliability figures, and every cell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viz.cells import chip, tally
from viz.figures import FAINT, INK, save_svg
from viz.page import heading, inline_svg, paragraph, read_verdicts, section, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TONES = {
    "sound": "good",
    "warned": "dull",
    "refused": "dull",
    "skipped": "dull",
    "silently wrong": "bad",
    "met": "good",
    "missed": "bad",
    "not measured": "dull",
}
MARKS = {  # verdict -> colour and marker, told apart without colour as well
    "sound": ("#009E73", "o"),
    "warned": ("#E69F00", "^"),
    "refused": ("#0072B2", "s"),
    "silently wrong": ("#D55E00", "X"),
}
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
    parts = [_axis(run, name, cells) for name, cells in axes.items()]
    sections = [_short(about, found), _figures(found["figures"]), *parts]
    lead = (
        "Each cell is run against a float64 or analytic reference. An error "
        "beyond its bound must have been warned of by name before the result was returned, "
        "or refused in a sentence; else the cell is silently wrong."
    )
    head = heading("At the extremes: sound, warned of, or refused", lead)
    return write_page(run, "Stress", head, sections)


def _short(about: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    counts = _tally(found["counts"])
    facts = (
        f"{len(found['cells'])} cells, preset {about['settings']['preset']}, "
        f"{found['seconds']:.0f} seconds of one core, code {about['code_version']}."
    )
    wrong = [cell for cell in found["cells"] if cell["verdict"] == "silently wrong"]
    said = "".join(f"<li>{escape(cell['name'])}: {escape(_said(cell))}</li>" for cell in wrong)
    callout = f'<div class="callout"><p>Silently wrong:</p><ul>{said}</ul></div>' if wrong else ""
    return section("short", "In short", counts, paragraph(facts), callout)


def _tally(counts: Mapping[str, int]) -> str:
    return tally((f"{count} {verdict}", TONES[verdict]) for verdict, count in counts.items())


def _figures(rows: Cells) -> str:
    lines = "".join(
        f"<tr><th>{row['name']}</th><td>{escape(row['promise'])}</td><td>{escape(row['bound'])}</td>"
        f"<td>{escape(row['measured'])}</td><td>{chip(row['verdict'], TONES[row['verdict']])}</td>"
        f'<td class="said">{escape(row["why"])}</td></tr>'
        for row in rows
    )
    head = "".join(
        f"<th>{name}</th>" for name in ("id", "what", "bound", "measured", "verdict", "why")
    )
    table = f'<div class="scroll"><table><thead><tr>{head}</tr></thead>{lines}</table></div>'
    return section("figures", "The reliability figures", table)


def _axis(run: Path, name: str, cells: Cells) -> str:
    anchor = "".join(c for c in name if c.isalnum())
    counts = Counter(cell["verdict"] for cell in cells)
    parts = [_tally(counts)]
    drawn = [cell for cell in cells if cell["verdict"] in MARKS]
    if len({cell["value"] for cell in drawn}) > 1:  # at one place there is nothing to be seen along
        path = run / "figures" / f"stress-{anchor}.svg"
        save_svg(axis_figure(name, cells), path)
        label = f"Error against bound along {name}"
        parts.append(inline_svg(path.read_text(encoding="utf-8"), label, ""))
    lines = "".join(
        f"<tr><td>{escape(cell['system'])}</td><td>{escape(cell['extreme'])}</td>"
        f"<td>{cell['integrator']}</td><td>{cell['dtype']}</td><td>{cell['path']}</td>"
        f'<td class="num">{_number(cell["error"])}</td><td class="num">{cell["bound"]:.1g}</td>'
        f"<td>{chip(cell['verdict'], TONES[cell['verdict']])}</td>"
        f'<td class="said">{escape(cell["said"])}</td></tr>'
        for cell in cells
    )
    names = "system", "extreme", "method", "precision", "path", "error", "bound", "verdict", "said"
    head = "".join(f"<th>{word}</th>" for word in names)
    table = f'<div class="scroll"><table><thead><tr>{head}</tr></thead>{lines}</table></div>'
    parts.append(f"<details><summary>{len(cells)} cells</summary>{table}</details>")
    return section(anchor, name, *parts)


def axis_figure(name: str, cells: Cells) -> Figure:
    """Error over bound along an axis: below the line is sound, what has no number lies on top.

    Args:
        name: of the axis.
        cells: as in ``verdicts.json``.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    axes = figure.subplots()
    for verdict, (colour, marker) in MARKS.items():
        drawn = [cell for cell in cells if cell["verdict"] == verdict]
        if drawn:
            x = [max(abs(cell["value"]), 1e-9) for cell in drawn]
            y = [_ratio(cell) for cell in drawn]
            axes.plot(x, y, marker, ls="", color=colour, alpha=0.6, label=verdict, mew=0)
    axes.axhline(1.0, color=INK, lw=1)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(name)
    axes.set_ylabel("error over its bound")
    axes.grid(color=FAINT, alpha=0.25, lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, loc="best", frameon=False)
    return figure


def _ratio(cell: Mapping[str, Any]) -> float:
    if cell["error"] is None:
        return CEILING
    bound = cell["bound"] or 1.0
    return min(CEILING, max(FLOOR, cell["error"] / bound))


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.2g}"


def _said(cell: Mapping[str, Any]) -> str:
    return f"error {_number(cell['error'])}, bound {cell['bound']:.1g} {cell['said']}"
