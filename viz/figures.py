"""Figures of a run, from its records: what inverts, which force was learned, what drifts.

Every function takes :class:`viz.summary.Records` (built from rows as dicts) and returns a
matplotlib figure; :func:`save_svg` and :func:`save_png` write it. Importing this file costs no
matplotlib.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viz.legend import named_handles
from viz.summary import SKILL_BAR, Line, Records, median
from viz.whole import whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# After Okabe and Ito, each with its own marker: told apart without colour as well. Each stands
# out on white, where figures are drawn, and on a dark page, where tables name the heads.
STYLES = {
    "factored": ("#0072B2", "o"),
    "factored-radial": ("#009E73", "^"),
    "factored-learned-kinetic": ("#3A8FC4", "D"),
    "symplectic": ("#CC79A7", "v"),
    "unstructured": ("#D55E00", "s"),
}
SPARE = (("#A87900", "P"), ("#9A6A50", "X"), ("#7F7F7F", "*"))
DRIFT_CAP = 1e4  # larger drifts are drawn at the cap; the records keep them
INK, FAINT = "#222222", "#8a8a8a"
_TEXT: dict[Any, Any] = {
    "font.size": 11,
    "axes.edgecolor": "#bbbbbb",
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "vidphys",
    "svg.fonttype": "none",
}


def style(head: str, heads: list[str]) -> tuple[str, str]:
    """Colour and marker of a head, the same in every figure of a run."""
    unknown = [name for name in heads if name not in STYLES]
    return STYLES[head] if head in STYLES else SPARE[unknown.index(head) % len(SPARE)]


def ladder_figure(records: Records, references: Mapping[str, float] | None = None) -> Figure:
    """Error under the flipped coupling for each rung and head, one small mark a seed.

    Args:
        records: a run's records.
        references: figures to compare with, nMSE by cell (``grounding/head``).
    """
    coupling = records.coupling
    figure, axes, levels = _rows_figure(records)
    axes.set_xscale("log")
    _dots(axes, records, levels, "inversion_nmse")
    for lines in records.rungs.values():
        found = [records.pick(line, "ballistic_nmse", coupling=coupling) for line in lines]
        values = [value for one in found if one for value in one.values]
        if values:
            ends = [levels[lines[0]] - 0.8, levels[lines[-1]] + 0.8]
            still = sum(values) / len(values)
            _once(axes, [still] * 2, ends, "no force at all (skill = 1)", ls=":")
            # as in the first figure of a report
            _once(axes, [SKILL_BAR * still] * 2, ends, "half of that: left of it counts", ls="--")
    for line, level in levels.items():
        value = (references or {}).get(f"{line.grounding}/{line.head}")
        if value is not None and line.readout != "shooting":  # which the study does not have
            _once(axes, [value], [level], "the study", marker="*", ms=13, ls="", hollow=True)
    axes.set_xlabel(f"inversion nMSE{_at(coupling)}   (smaller is better, logarithmic)")
    _legend(figure, [axes])
    return figure


def force_figure(records: Records) -> Figure:
    """Cosine between the learned and the true force under the flipped coupling."""
    figure, axes, levels = _rows_figure(records)
    axes.set_xlim(-1.05, 1.05)
    for x in (0, 1):
        axes.axvline(x, color=FAINT, lw=1, ls=":")
    _dots(axes, records, levels, "force_cosine")
    words = "1: the true direction, 0: none, -1: reversed"
    axes.set_xlabel(f"force cosine{_at(records.coupling)}   ({words})")
    _legend(figure, [axes])
    return figure


def drift_figure(records: Records) -> Figure:
    """Relative energy drift against simulation steps: median line, band up to the worst episode."""
    import matplotlib
    from matplotlib.figure import Figure

    rungs = {rung: lines for rung, lines in records.rungs.items() if _drifts(records, lines)}
    columns = min(4 if len(rungs) > 9 else 3, max(1, len(rungs)))
    rows = -(-len(rungs) // columns) if rungs else 1
    width, height = 3.0 * columns + 0.8, 2.1 * rows + 1.3
    with matplotlib.rc_context(_TEXT):
        figure = Figure(figsize=(width, height))
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        panels = list(grid.flat)
        for axes, (rung, lines) in zip(panels, rungs.items(), strict=False):
            _drift_panel(axes, records, rung, lines)
        for k, axes in enumerate(panels):
            axes.set_visible(k < len(rungs))
            axes.tick_params(labelbottom=k + columns >= len(rungs))
        figure.supxlabel("simulation steps", fontsize=11)
        figure.supylabel("relative energy drift", fontsize=11, x=0.12 / width)
    # Margins in inches; the automatic layout takes seconds for as many panels.
    left, right, bottom, top = 0.8 / width, 1 - 0.1 / width, 0.65 / height, 1 - 0.75 / height
    figure.subplots_adjust(left, bottom, right, top, wspace=0.08, hspace=0.24)
    _legend(figure, panels)
    return figure


def save_svg(figure: Figure, path: Path) -> None:
    """Write a figure as vectors, text as text, so that it is read aloud, found and small."""
    import matplotlib

    with whole(path) as part, matplotlib.rc_context(_TEXT):
        figure.savefig(part, format="svg", metadata={"Date": None, "Creator": None})


def save_png(figure: Figure, path: Path, dots_per_inch: int = 110) -> None:
    """Write a figure as pixels."""
    with whole(path) as part:
        figure.savefig(part, format="png", dpi=dots_per_inch, metadata={"Software": None})


def _rows_figure(records: Records) -> tuple[Figure, Axes, dict[Line, float]]:
    """A level per line, the first on top, rungs in bands of their own."""
    import matplotlib
    from matplotlib.figure import Figure

    levels: dict[Line, float] = {}
    middles, edge = [], 0.0
    for lines in records.rungs.values():
        levels |= {line: edge + 1.1 + k for k, line in enumerate(lines)}
        middles.append(edge + 1.1 + (len(lines) - 1) / 2)
        edge += len(lines) + 1.2
    with matplotlib.rc_context(_TEXT):
        figure = Figure(figsize=(9.5, 0.17 * edge + 1.5), layout="constrained")
        axes = figure.subplots()
    axes.set_yticks(middles, list(records.rungs))
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(edge, 0)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="x", color="#e8e8e8", lw=0.8)
    axes.set_axisbelow(True)
    for lines in list(records.rungs.values())[::2]:
        top, bottom = levels[lines[0]] - 1.1, levels[lines[-1]] + 1.1
        axes.axhspan(top, bottom, color="#f6f7f8", zorder=0, lw=0)
    return figure, axes, levels


def _dots(axes: Axes, records: Records, levels: Mapping[Line, float], metric: str) -> None:
    """Small open marks for seeds, a large one for the mean, words for what has no number."""
    for line, level in levels.items():
        found = records.pick(line, metric, coupling=records.coupling)
        if found is None:
            continue
        colour, marker = style(line.head, records.heads)
        if found.mean is not None:
            seeds = [level] * len(found.values)
            axes.plot(found.values, seeds, marker, ms=4, color=colour, mfc="none", mew=0.8)
            _once(axes, [found.mean], [level], line.head, color=colour, marker=marker, ms=9, ls="")
        if found.words:
            axes.annotate(
                f"{line.head}: {found.words}",
                xy=(1.01, level),
                xycoords=("axes fraction", "data"),
                fontsize=8.5,
                color=INK,
                va="center",
                annotation_clip=False,
            )


def _once(
    axes: Axes,
    x: list[float],
    y: list[float],
    label: str,
    color: str = INK,
    marker: str = "",
    ms: float = 1,
    ls: str = ":",
    hollow: bool = False,
) -> None:
    """Draw, and name it in the legend the first time only."""
    known = axes.get_legend_handles_labels()[1]
    (drawn,) = axes.plot(x, y, color=color, marker=marker, ms=ms, ls=ls, mec="white", mew=0.9)
    drawn.set_label("" if label in known else label)
    if hollow:
        drawn.set(mfc="none", mec=color)


def _at(coupling: float | None) -> str:
    return "" if coupling is None else f" at G = {coupling:g}"


def _drifts(records: Records, lines: list[Line]) -> bool:
    return any(records.pick(line, "energy_drift_median") for line in lines)


def _drift_panel(axes: Axes, records: Records, rung: str, lines: list[Line]) -> None:
    axes.set(xscale="log", yscale="log")
    axes.set_title(rung, fontsize=9, loc="left")
    short = [f"{h / 1000:g}k" if h >= 1000 else str(h) for h in records.horizons]
    axes.set_xticks(records.horizons, short, fontsize=9)
    axes.minorticks_off()
    axes.grid(color="#eeeeee", lw=0.8)
    axes.set_axisbelow(True)
    axes.axhline(1, color=FAINT, lw=1, ls=":")
    words = [text for line in lines if (text := _drift_lines(axes, records, line))]
    axes.text(0.03, 0.97, "\n".join(words), va="top", fontsize=8.5, transform=axes.transAxes)


def _drift_lines(axes: Axes, records: Records, line: Line) -> str:
    """The median over the seeds' medians, a band to any seed's worst episode; words if neither."""
    steps, middle, worst, words = [], [], [], ""
    for horizon in records.horizons:
        half = records.pick(line, "energy_drift_median", horizon=horizon)
        most = records.pick(line, "energy_drift_worst", horizon=horizon)
        if half is None:
            continue
        words = f"{line.head}: {half.words}" if half.words else words
        centre = median(half.values)
        if centre is None:
            continue
        steps.append(horizon)
        middle.append(min(centre, DRIFT_CAP))
        top = max(most.values) if most and most.values else centre
        worst.append(min(top, DRIFT_CAP))
    colour, marker = style(line.head, records.heads)
    if steps:
        axes.plot(steps, middle, color=colour, marker=marker, ms=5, lw=1.8, label=line.head)
        axes.fill_between(steps, middle, worst, color=colour, alpha=0.15, lw=0)
        axes.plot(steps, worst, color=colour, lw=0.8, ls=":")
    return words


def _legend(figure: Figure, panels: list[Axes]) -> None:
    handles, labels = named_handles(panels)
    if handles:
        figure.legend(
            handles,
            labels,
            loc="outside upper left" if figure.get_layout_engine() else "upper left",
            ncols=4,
            frameon=False,
            fontsize=10,
        )
