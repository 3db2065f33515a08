"""Figures of a table over one axis: a coupling, steps, a size, or cells below each other."""

from __future__ import annotations

import re
import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from viz.figures import FAINT, INK, SPARE, STYLES
from viz.legend import named_handles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Rows = Sequence[Mapping[str, Any]]
Points = dict[float, list[float | None]]  # place on the axis -> a value for each seed


def sweep_figure(sweep: Mapping[str, Any], records: Rows) -> Figure | None:
    """Draw a sweep: small marks for seeds, a line or a large mark for their median.

    Args:
        sweep: as a table declares it (``Sweep`` of the tables), read from ``verdicts.json``.
        records: of the table, as dicts. A number that is not there because a seed failed is
            drawn as a cross at the edge, never given a value.

    Returns:
        The figure, or ``None`` if no panel has a number.
    """
    from matplotlib.figure import Figure

    drawn = [lines_of(panel, sweep["along"], records) for panel in sweep["panels"]]
    names = list(dict.fromkeys(name for lines in drawn for name in lines))
    if not names:
        return None
    count = len(drawn)
    height = 3.4 if sweep["along"] else 0.8 + 0.27 * len(names)
    figure = Figure(figsize=(2.6 + 3.6 * count, height))
    axes = figure.subplots(1, count, squeeze=False, sharey=not sweep["along"])[0]
    for ax, panel, lines in zip(axes, sweep["panels"], drawn, strict=True):
        if sweep["along"]:
            _curves(ax, panel, lines, names)
            ax.set_xlabel(sweep["label"], color=INK)
            if sweep["logarithmic"]:
                _logarithmic(ax, "x")
        else:
            _levels(ax, panel, lines, names)
        ax.spines[["top", "right"]].set_visible(False)
    if sweep["along"]:
        figure.legend(*named_handles(axes), fontsize=8, frameon=False, loc="center right")
    longest = 0.3 + 0.075 * max(map(len, names))  # inches that a name takes
    _margins(figure, 0.9 if sweep["along"] else longest, longest + 0.4 if sweep["along"] else 0.2)
    return figure


def _margins(figure: Figure, left: float, right: float) -> None:
    """Margins in inches: names of cells stand left, a legend right; automatic layout is slow."""
    width, height = figure.get_size_inches()
    figure.subplots_adjust(
        left / width, 0.6 / height, 1 - right / width, 1 - 0.15 / height, wspace=0.32
    )


def lines_of(panel: Mapping[str, Any], along: str, records: Rows) -> dict[str, Points]:
    """The numbers of a panel: model -> place on the axis -> a value for each seed."""
    lines: dict[str, Points] = {}
    for record in records:
        if not _belongs(record, panel):
            continue
        name: str = record["cell"]
        place: float | None = 0.0
        if along in ("coupling", "horizon"):
            place = record[along]
        elif along == "cell":
            name, place = split_number(name)
        if place is not None:
            lines.setdefault(name, {}).setdefault(place, []).append(record["value"])
    if not any(value is not None for points in lines.values() for value in _values(points)):
        return {}
    return lines


def split_number(cell: str) -> tuple[str, float | None]:
    """``factored/32`` is factored at 32; the number is ``None`` where the name ends otherwise."""
    line, _, last = cell.rpartition("/")
    found = re.search(r"\d+(\.\d+)?$", last)
    return (line, float(found[0])) if line and found else (cell, None)


def _belongs(record: Mapping[str, Any], panel: Mapping[str, Any]) -> bool:
    return (
        record["metric"] == panel["metric"]
        and panel["coupling"] in (None, record["coupling"])
        and panel["horizon"] in (None, record["horizon"])
        and re.search(panel["cells"], record["cell"]) is not None
    )


def _values(points: Points) -> Iterable[float | None]:
    return (value for values in points.values() for value in values)


def _looks(name: str, names: Sequence[str]) -> tuple[str, str, str]:
    """Colour, marker and dashes of a line, the same in every panel."""
    if name in STYLES:
        return (*STYLES[name], "-")
    spare = [n for n in names if n not in STYLES].index(name)
    palette = (*SPARE, *(s for key, s in STYLES.items() if key not in names))
    return (*palette[spare % len(palette)], ("-", "--", ":")[spare // len(palette) % 3])


def _scale(axes: Axes, name: Literal["x", "y"], logarithmic: bool) -> None:
    """Logarithmic, or linear; shares are seen between 0 and 1."""
    low, high = axes.get_xlim() if name == "x" else axes.get_ylim()
    if logarithmic:
        _logarithmic(axes, name)
    elif low > -0.1 and high < 1.1:
        axes.set(**{f"{name}lim": (-0.05, 1.05)})


def _logarithmic(axes: Axes, name: Literal["x", "y"]) -> None:
    """A scale whose labels do not run into each other."""
    axes.set(**{f"{name}scale": "log"})
    plain_ticks(axes, name)


def plain_ticks(axes: Axes, name: Literal["x", "y"]) -> None:
    """Of a logarithmic axis: none between; 1, 2 and 5 for about a decade; four for less."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    axis = axes.xaxis if name == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    if high < 30 * low:
        few = high < 5 * low  # 1, 2 and 5 may come once, or not at all
        axis.set_major_locator(
            MaxNLocator(4, steps=[1, 2, 5, 10]) if few else LogLocator(subs=(1, 2, 5))
        )
        axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def _curves(
    axes: Axes, panel: Mapping[str, Any], lines: Mapping[str, Points], names: Sequence[str]
) -> None:
    for name, points in lines.items():
        colour, marker, dashes = _looks(name, names)
        kept = {x: [v for v in values if v is not None] for x, values in sorted(points.items())}
        known = {x: statistics.median(values) for x, values in kept.items() if values}
        axes.plot(
            list(known), list(known.values()), dashes, color=colour, marker=marker, ms=5, label=name
        )
        for x, values in kept.items():
            axes.plot([x] * len(values), values, marker, color=colour, ms=2.5)
            if len(values) < len(points[x]):
                axes.plot(x, 0.985, "x", color=colour, ms=7, transform=axes.get_xaxis_transform())
    _scale(axes, "y", panel["logarithmic"])
    axes.set_ylabel(panel["label"], color=INK)
    axes.grid(color="#e6e9ec", lw=0.6)


def _levels(
    axes: Axes, panel: Mapping[str, Any], lines: Mapping[str, Points], names: Sequence[str]
) -> None:
    for name, points in lines.items():
        level = names.index(name)
        values = [value for value in _values(points) if value is not None]
        axes.plot(values, [level] * len(values), "|", color=FAINT, ms=9)
        if values:
            axes.plot(statistics.median(values), level, "o", color=INK, ms=5)
        if len(values) < sum(1 for _ in _values(points)):
            axes.plot(0.985, level, "x", color=INK, ms=7, transform=axes.get_yaxis_transform())
    _scale(axes, "x", panel["logarithmic"])
    axes.set_xlabel(panel["label"], color=INK)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(axis="x", color="#e6e9ec", lw=0.6)
