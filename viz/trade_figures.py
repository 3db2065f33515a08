"""Figures of speed against accuracy, from rows of measured points as dicts.

A row has ``front``, ``task``, ``configuration`` (a dict), ``cost``, ``cost_low``, ``cost_high``,
``cost_name``, ``error`` (``None``: not finite), ``error_name``, ``units`` and ``best`` (no other
point of its task is both cheaper and more accurate).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from viz.figures import _TEXT, FAINT, INK, SPARE, STYLES
from viz.legend import named_handles
from viz.sweeps import plain_ticks

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = Mapping[str, Any]
MARKS = (*STYLES.values(), *SPARE)
UNITS = {"us": "µs", "ms": "ms", "s": "s", "ns": "ns", "bytes": "bytes"}
EXACT = 0.2  # of the smallest other error: where one of exactly zero is drawn, as "0"
SMALLEST = 1e-16  # error that a colour tells from zero


def pareto_figure(rows: Sequence[Row], by: Sequence[str]) -> Figure:
    """Cost against error for each task, with the front drawn through the points that are on it.

    Args:
        rows: of one front.
        by: settings that give colour and marker.
    """
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    figure, panels = _grid(len(tasks))
    kinds = list(dict.fromkeys(_kind(row, by) for row in rows))
    for axes, task in zip(panels, tasks, strict=False):
        _panel(axes, [row for row in rows if row["task"] == task], by, kinds)
        axes.set_title(task, fontsize=9, loc="left")
    _name(figure, panels, by)
    return figure


def work_precision_figure(rows: Sequence[Row]) -> Figure:
    """Error against time and against force evaluations, a line for each method of a rollout."""
    figure, panels = _grid(2)
    lines: dict[str, list[Row]] = {}
    for row in rows:
        told = row["configuration"]
        pieces = ", pieces" if told["substeps"] else ""
        lines.setdefault(f"{told['integrator']}, {told['dtype']}{pieces}", []).append(row)
    floor = _floor(rows)
    for number, (name, line) in enumerate(lines.items()):
        colour, marker = MARKS[number % len(MARKS)]
        finite = sorted((r for r in line if r["error"] is not None), key=lambda r: r["cost"])
        errors = [r["error"] or floor for r in finite]
        for axes, work in zip(panels, (_cost, _forces), strict=False):
            axes.plot([work(r) for r in finite], errors, color=colour, marker=marker, label=name)
    for axes, words in zip(
        panels,
        (in_words(rows[0]["cost_name"]), "force evaluations a simulated second"),
        strict=False,
    ):
        _scaled(axes, rows, words)
    _legend(figure, panels)
    return figure


def crowd_figure(rows: Sequence[Row]) -> Figure:
    """Time of a force against the number of bodies, coloured by its error."""
    import matplotlib

    laws = list(dict.fromkeys(row["task"].rsplit(",", 1)[0] for row in rows))
    figure, panels = _grid(len(laws))
    norm = matplotlib.colors.LogNorm(SMALLEST, 1)
    for axes, law in zip(panels, laws, strict=False):
        lines: dict[str, list[Row]] = {}
        for row in rows:
            told = row["configuration"]
            if row["task"].startswith(law):
                lines.setdefault(f"{told['evaluation']}, {told['dtype']}", []).append(row)
        for number, (name, line) in enumerate(lines.items()):
            bodies = [row["configuration"]["bodies"] for row in line]
            costs = [row["cost"] for row in line]
            axes.plot(bodies, costs, color=MARKS[number][0], lw=1, label=name, zorder=1)
            shade = [max(row["error"] or 0.0, SMALLEST) for row in line]
            drawn = axes.scatter(
                bodies, costs, c=shade, norm=norm, cmap="viridis_r", s=45, zorder=2
            )
        axes.set(xscale="log", yscale="log", xlabel="bodies", ylabel=in_words(rows[0]["cost_name"]))
        plain_ticks(axes, "x")
        axes.set_title(law, fontsize=9, loc="left")
    figure.colorbar(drawn, ax=panels, label=in_words(rows[0]["error_name"]))
    _legend(figure, panels)
    return figure


def _kind(row: Row, by: Sequence[str]) -> str:
    """One setting is told by its value, several by their names too; not those without a value."""
    told = {name: row["configuration"].get(name) for name in by}
    if len(by) == 1:
        return str(told[by[0]])
    return ", ".join(f"{k.replace('_', ' ')} {v}" for k, v in told.items() if v is not None)


def _mark(number: int) -> tuple[str, str]:
    """Colour and marker of a kind: all pairs differ, in whichever order colours come again."""
    turn = number // len(MARKS)
    return MARKS[number % len(MARKS)][0], MARKS[(number + turn) % len(MARKS)][1]


def _panel(axes: Axes, rows: Sequence[Row], by: Sequence[str], kinds: Sequence[str]) -> None:
    floor = _floor(rows)
    for row in rows:
        kind = _kind(row, by)
        colour, marker = _mark(kinds.index(kind))
        failed = row["error"] is None
        y = 1.0 if failed else row["error"] or floor
        spread = [[row["cost"] - row["cost_low"]], [row["cost_high"] - row["cost"]]]
        axes.errorbar(
            row["cost"],
            y,
            xerr=spread,
            fmt=marker,
            color=colour,
            mfc="none" if failed else colour,
            ms=8 if row["best"] else 5.5,
            lw=1,
            label=kind,
        )
    best = sorted((row for row in rows if row["best"]), key=_cost)
    errors = [row["error"] or floor for row in best]
    axes.step([_cost(row) for row in best], errors, where="post", color=INK, lw=1, alpha=0.6)
    _scaled(axes, rows, in_words(rows[0]["cost_name"]))


def in_words(name: str) -> str:
    """A measure in words, its unit first: ``us_per_frame`` is µs per frame."""
    first, *others = name.split("_")
    return " ".join([UNITS.get(first, first), *others])


def _floor(rows: Sequence[Row]) -> float:
    """Where an error of exactly zero is drawn: below all others, wherever they are."""
    return EXACT * min((row["error"] for row in rows if row["error"]), default=1.0)


def _scaled(axes: Axes, rows: Sequence[Row], words: str) -> None:
    """Both axes logarithmic, in words; the level of exact results is called 0."""
    axes.set(xscale="log", yscale="log", xlabel=words, ylabel=in_words(rows[0]["error_name"]))
    plain_ticks(axes, "x")
    plain_ticks(axes, "y")
    if any(row["error"] == 0 for row in rows):
        floor = _floor(rows)
        axes.axhline(floor, color=FAINT, lw=0.8, ls=":")
        axes.annotate(
            "0 (exact)",
            (0.01, floor),  # where what is cheapest stands, which is seldom exact
            xycoords=("axes fraction", "data"),
            fontsize=8,
            ha="left",
            va="bottom",
            color=INK,
        )


def _cost(row: Row) -> float:
    return row["cost"]


def _forces(row: Row) -> float:
    return row["units"]["force_evaluations"]


def _grid(count: int) -> tuple[Figure, list[Axes]]:
    import matplotlib
    from matplotlib.figure import Figure

    columns = min(2, count)
    rows = -(-count // columns)
    with matplotlib.rc_context(_TEXT):
        figure = Figure(figsize=(5.2 * columns, 3.6 * rows + 0.6), layout="constrained")
        panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in panels[count:]:
        axes.set_visible(False)
    for axes in panels:
        axes.grid(color="#eeeeee", lw=0.8)
        axes.set_axisbelow(True)
    return figure, panels[:count]


def _name(figure: Figure, panels: Sequence[Axes], by: Sequence[str]) -> None:
    handles, labels = named_handles(panels)
    if len(handles) > 1:
        _beside(figure, handles, labels, by[0] if len(by) == 1 else None)


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    _beside(figure, *named_handles(panels), None)


def _beside(figure: Figure, handles: list[Artist], labels: list[str], title: str | None) -> None:
    """A narrow legend beside the panels, which keep their size: the figure grows by it."""
    width, height = figure.get_size_inches()
    longest = max(len(label) for label in (*labels, title or ""))
    figure.set_size_inches(width + 0.5 + 0.075 * longest, height)
    figure.legend(
        handles,
        labels,
        title=title,
        loc="outside right upper",
        frameon=False,
        fontsize=8,
        title_fontsize=8,
        labelcolor=INK,
    )
