"""Figures of a run, from its records: what inverts, which force was learned, what drifts.

Every function takes :class:`viz.summary.Records` (built from rows as dicts) and returns a
matplotlib figure; :func:`save_svg` and :func:`save_png` write it. Importing this file costs no
matplotlib.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viz.summary import Line, Records, Summary, median

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, each with its own marker: told apart without colour as well.
STYLES = {
    "factored": ("#0072B2", "o"),
    "factored-radial": ("#009E73", "^"),
    "factored-learned-kinetic": ("#56B4E9", "D"),
    "symplectic": ("#CC79A7", "v"),
    "unstructured": ("#D55E00", "s"),
}
SPARE = (("#E69F00", "P"), ("#000000", "X"), ("#999999", "*"))
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
    figure, axes = _rows_figure(records)
    axes.set_xscale("log")
    _dots(axes, records, lambda line: records.pick(line, "inversion_nmse", coupling=coupling))
    for y, lines in enumerate(records.rungs.values()):
        values = [
            value
            for line in lines
            if (found := records.pick(line, "ballistic_nmse", coupling=coupling))
            for value in found.values
        ]
        if values:
            mean = sum(values) / len(values)
            label = "no force at all (skill = 1)" if y == 0 else None
            axes.plot([mean] * 2, [y - 0.42, y + 0.42], color=INK, lw=1.6, ls=":", label=label)
        for line in lines:
            paper = (references or {}).get(f"{line.grounding}/{line.head}")
            if paper is not None and line.readout != "shooting":  # which the study does not have
                label = None if "the study" in _labels(axes) else "the study"
                axes.plot(paper, y, marker="*", ms=13, mfc="none", mec=INK, ls="", label=label)
    words = "" if coupling is None else f" at G = {coupling:g}"
    axes.set_xlabel(f"inversion nMSE{words}   (smaller is better, logarithmic)")
    _legend(figure, [axes])
    return figure


def force_figure(records: Records) -> Figure:
    """Cosine between the learned and the true force under the flipped coupling."""
    coupling = records.coupling
    figure, axes = _rows_figure(records)
    axes.axvline(0, color=FAINT, lw=1, ls=":")
    axes.axvline(1, color=FAINT, lw=1, ls=":")
    axes.set_xlim(-1.05, 1.05)
    _dots(axes, records, lambda line: records.pick(line, "force_cosine", coupling=coupling))
    words = "" if coupling is None else f" at G = {coupling:g}"
    axes.set_xlabel(f"force cosine{words}   (1: the true direction, 0: none, -1: reversed)")
    _legend(figure, [axes])
    return figure


def drift_figure(records: Records) -> Figure:
    """Relative energy drift against simulation steps: median line, band up to the worst episode."""
    import matplotlib
    from matplotlib.figure import Figure

    rungs = {rung: lines for rung, lines in records.rungs.items() if _drifts(records, lines)}
    columns = min(3, max(1, len(rungs)))
    rows = -(-len(rungs) // columns) if rungs else 1
    with matplotlib.rc_context(_TEXT):
        figure = Figure(figsize=(3.5 * columns + 0.6, 2.6 * rows + 0.9), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes in grid.flat:
            axes.set(xscale="log", yscale="log")
            axes.grid(color="#eeeeee", lw=0.8)
            axes.set_axisbelow(True)
        for axes in list(grid.flat)[len(rungs) :]:
            axes.set_visible(False)
        for axes, (rung, lines) in zip(grid.flat, rungs.items(), strict=False):
            axes.set_title(rung, fontsize=11, loc="left")
            axes.axhline(1, color=FAINT, lw=1, ls=":")
            axes.set_xticks(records.horizons, [f"{h:,}" for h in records.horizons], minor=False)
            axes.minorticks_off()
            words = [text for line in lines if (text := _drift_lines(axes, records, line))]
            axes.text(0.03, 0.97, "\n".join(words), va="top", fontsize=9, transform=axes.transAxes)
        figure.supxlabel("simulation steps", fontsize=11)
        figure.supylabel("relative energy drift", fontsize=11)
        _legend(figure, list(grid.flat))
    return figure


def save_svg(figure: Figure, path: Path) -> None:
    """Write a figure as vectors, text drawn as outlines so that it looks the same everywhere."""
    import matplotlib

    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(_TEXT):
        figure.savefig(path, format="svg", metadata={"Date": None, "Creator": None})


def save_png(figure: Figure, path: Path, dots_per_inch: int = 110) -> None:
    """Write a figure as pixels."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png", dpi=dots_per_inch, metadata={"Software": None})


def _rows_figure(records: Records) -> tuple[Figure, Axes]:
    """A row per rung, the first on top."""
    import matplotlib
    from matplotlib.figure import Figure

    rungs = list(records.rungs)
    heads = max(len(lines) for lines in records.rungs.values())
    with matplotlib.rc_context(_TEXT):
        height = (0.3 + 0.11 * heads) * len(rungs) + 1.6
        figure = Figure(figsize=(9.5, height), layout="constrained")
        axes = figure.subplots()
    axes.set_yticks(range(len(rungs)), rungs)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(rungs) - 0.5, -0.5)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="x", color="#e8e8e8", lw=0.8)
    axes.set_axisbelow(True)
    for y in range(0, len(rungs), 2):
        axes.axhspan(y - 0.5, y + 0.5, color="#f6f7f8", zorder=0, lw=0)
    return figure, axes


def _dots(axes: Axes, records: Records, pick: Callable[[Line], Summary | None]) -> None:
    """Small marks for seeds, a large one for the mean, words for what has no number."""
    shown: set[str] = set()
    for y, lines in enumerate(records.rungs.values()):
        for k, line in enumerate(lines):
            found = pick(line)
            if found is None:
                continue
            level = y + 0.74 * ((k + 0.5) / len(lines) - 0.5)
            colour, marker = style(line.head, records.heads)
            if found.mean is not None:
                label = None if line.head in shown else line.head
                shown.add(line.head)
                levels = [level] * len(found.values)
                axes.plot(found.values, levels, marker, ms=5, color=colour, alpha=0.35, mew=0)
                axes.plot(
                    found.mean, level, marker, ms=9, color=colour, mec="white", mew=0.9, label=label
                )
            if found.words:
                axes.annotate(
                    f"{line.head}: {found.words}",
                    xy=(1.01, level),
                    xycoords=("axes fraction", "data"),
                    fontsize=8.5,
                    color=colour,
                    va="center",
                    annotation_clip=False,
                )


def _drifts(records: Records, lines: list[Line]) -> bool:
    return any(records.pick(line, "energy_drift_median") for line in lines)


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
    return words


def _labels(axes: Axes) -> list[str]:
    return axes.get_legend_handles_labels()[1]


def _legend(figure: Figure, panels: list[Axes]) -> None:
    handles: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        figure.legend(
            list(handles.values()),
            list(handles),
            loc="outside upper left",
            ncols=4,
            frameon=False,
            fontsize=10,
        )
