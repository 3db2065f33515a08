"""One page on a diagnosis: what was seen, what the model says of it, and what it leaves."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from viz.legend import named_handles
from viz.overlay import MAX_SIDE, shrink

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The hue is the body, the style of the line is the law. Each hue has 3 : 1 on white and on HELD.
HUES = ("#0072B2", "#C04A00", "#007A5A", "#A8538A", "#7A6A00", "#555555")
PAIR, REFUSED, INK = "#0072B2", "#8a8a8a", "#222222"
CHANGED = ("--", ":", "-.", (0, (6, 2, 1, 2)))
WALL, HELD = "#222222", "#f3ece4"
WRAP = 130  # letters of a line above
MARKERS = (".", "+", "x")  # of the axes of what is left
INSIDE = 98  # per cent of what is left, that is drawn; outliers would hide it
COLUMNS, WIDE = 6, 95  # of a legend at most, and its letters in a row
HANDLE = 7  # letters that the mark of a label takes
Path = tuple[np.ndarray, np.ndarray]


def diagnosis_figure(
    times: np.ndarray,
    positions: np.ndarray,
    rolled: Mapping[str, Path],
    path: Path | None = None,
    *,
    said: Sequence[str] = (),
    unit: str = "",
    picture: tuple[np.ndarray, float] | None = None,
    probability: Mapping[str, float] | None = None,
    wall: Mapping[str, Any] | None = None,
    holds: Collection[str] | None = None,
) -> Figure:
    """Each axis with every body and the model, what it leaves, and the bodies' way beside them.

    Args:
        times: seconds, ``(t,)``.
        positions: ``(t, n, d)``, NaN where not seen.
        rolled: times and positions by name; ``model`` first, over frames that were held out, then
            changed laws.
        path: times and positions of the model, over frames that it was fitted to and others.
        said: the verdict, and more below it.
        unit: of the positions.
        picture: a frame ``(H, W, 3)`` that the bodies are in, and half of its longer side in the
            unit.
        probability: of each term, by name, where terms were weighed.
        wall: the ``axis`` and ``place`` of one that the only body strikes.
        holds: the terms that the verdict upholds; the others' bars are grey. All unless given.
    """
    import matplotlib
    from matplotlib.figure import Figure

    rows, plane = positions.shape[2], positions.shape[2] == 2
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": "#bbbbbb"}):
        figure = Figure(figsize=(13, 1.6 * (rows + 1) + 2.4), layout="constrained")
        sides: Any = (
            figure.subfigures(1, 2, width_ratios=[1.7, 1])
            if plane or probability
            else [figure.subfigures(1, 1)]
        )
        axes: Any = sides[0].subplots(rows + 1, 1, sharex=True)
        for k in range(rows):
            _along(axes[k], times, positions[..., k], rolled, path, k)
            axes[k].set_ylabel(_in("xyz"[k], unit))
            if wall is not None and "xyz"[k] == wall["axis"]:
                axes[k].axhline(wall["place"], color=WALL, lw=1, zorder=0, label="wall")
        _left(axes[rows], times, positions, path or rolled.get("model"), unit)
        if "model" in rolled:
            first, last = rolled["model"][0][[0, -1]]
            for panel in axes:
                panel.axvspan(first, last, color=HELD, zorder=-1, lw=0, label="held out")
        handles, labels = named_handles(axes[:rows])
        sides[0].legend(
            handles, labels, loc="outside upper center", ncols=_columns(labels), frameon=False
        )
        axes[rows].set_xlabel("seconds")
        if len(sides) > 1:
            around = _beside(sides[1], plane, bool(probability))
            if plane:
                _way(around[0], positions, path or rolled.get("model"), unit, picture)
            if probability:
                _terms(around[-1], probability, probability if holds is None else holds)
        _say(figure, said)
    return figure


def _say(figure: Figure, said: Sequence[str]) -> None:
    """The verdict as the title, what else is said below it in small."""
    if said:
        lines = [part for line in said for part in textwrap.wrap(line, WRAP)]
        title = figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=10)
        if len(lines) == 1:
            title.set_fontsize(13)


def _columns(labels: Sequence[str]) -> int:
    """Of a legend, as many as its figure is wide enough for."""
    sizes = [len(label) + HANDLE for label in labels]
    for count in range(min(COLUMNS, len(labels)), 1, -1):
        columns = np.array_split(sizes, count)  # each as wide as its widest label
        if sum(int(column.max()) for column in columns) < WIDE:
            return count
    return 1


def _in(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


def _hue(body: int) -> str:
    return HUES[body % len(HUES)]


def _body(body: int, bodies: int, what: str) -> str:
    """What a mark is called: by its body where there are several."""
    return what if bodies == 1 else f"body {body + 1}, {what}" if what == "recorded" else what


def _along(
    axes: Axes,
    times: np.ndarray,
    seen: np.ndarray,
    rolled: Mapping[str, Path],
    path: Path | None,
    axis: int,
) -> None:
    """One axis of every body: as recorded ``(t, n)``, by the model, under changed laws."""
    bodies = seen.shape[1]
    laws = [name for name in rolled if name != "model"]
    for n in range(bodies):
        hue = _hue(n)
        axes.plot(times, seen[:, n], ".", color=hue, ms=3, label=_body(n, bodies, "recorded"))
        if path is not None:
            axes.plot(path[0], path[1][:, n, axis], color=darker(hue), lw=1.2, label="model")
        for name, (when, places) in rolled.items():
            if name == "model":
                axes.plot(when, places[:, n, axis], color=darker(hue), lw=2.2, label="foretold")
            else:
                style = CHANGED[laws.index(name) % len(CHANGED)]
                axes.plot(when, places[:, n, axis], color=hue, lw=1, ls=style, label=name)
    low, high = np.nanmin(seen), np.nanmax(seen)
    room = 0.3 * (high - low)  # a changed law may go far
    if room > 0:
        axes.set_ylim(max(axes.get_ylim()[0], low - room), min(axes.get_ylim()[1], high + room))
    axes.tick_params(labelsize=8)


def darker(colour: str) -> tuple[float, ...]:
    """For a line that lies upon the marks of its own hue."""
    from matplotlib.colors import to_rgb

    return tuple(0.6 * part for part in to_rgb(colour))


def _left(
    axes: Axes, times: np.ndarray, positions: np.ndarray, path: Path | None, unit: str
) -> None:
    """What the model leaves of every coordinate of every body."""
    axes.set_ylabel(_in("recorded − model", unit))
    axes.axhline(0, color=INK, lw=0.8)
    axes.tick_params(labelsize=8)
    if path is None:
        return
    first = int(np.searchsorted(times, path[0][0] - 1e-9))
    both = min(len(path[0]), len(times) - first)  # it may go on where nothing was recorded
    when, left = path[0][:both], positions[first : first + both] - path[1][:both]
    if not both:
        return
    bodies, space = left.shape[1:]
    for n in range(bodies):
        for k in range(space):
            name = "xyz"[k] + (str(n + 1) if bodies > 1 else "")
            axes.plot(when, left[:, n, k], MARKERS[k], ms=3, color=_hue(n), label=name)
    most = float(np.nanpercentile(np.abs(left), INSIDE))
    if most > 0:
        axes.set_ylim(-1.4 * most, 1.4 * most)
    axes.legend(
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        fontsize=8,
        markerscale=2,
        ncols=1 + (bodies * space > 6),
        frameon=False,
    )


def _beside(side: Any, plane: bool, terms: bool) -> Any:
    """Panels for the way in the plane, and below it for how likely each term is."""
    return side.subplots(plane + terms, 1, squeeze=False)[:, 0]


def _way(
    axes: Axes,
    positions: np.ndarray,
    path: Path | None,
    unit: str,
    picture: tuple[np.ndarray, float] | None,
) -> None:
    if picture is not None:
        frame, half = picture
        height, width = (half * n / max(frame.shape[:2]) for n in frame.shape[:2])
        small = shrink(frame, -(-max(frame.shape[:2]) // MAX_SIDE))
        axes.imshow(small, extent=(-width, width, -height, height), alpha=0.8)
    for n in range(positions.shape[1]):
        axes.plot(*positions[:, n].T, ".", color=_hue(n), ms=3)
        if path is not None:
            axes.plot(*path[1][:, n].T, color=darker(_hue(n)), lw=0.8)
    axes.set(aspect="equal", xlabel=_in("x", unit), ylabel=_in("y", unit))
    axes.tick_params(labelsize=8)


def _terms(axes: Axes, probability: Mapping[str, float], holds: Collection[str]) -> None:
    """Bars; grey where the verdict does not uphold the term, however likely among the menu's."""
    tones = [PAIR if name in holds else REFUSED for name in probability]
    axes.barh(list(probability), list(probability.values()), color=tones)
    axes.invert_yaxis()
    words = "probability of the term within the menu"
    refused = any(value > 0.5 and name not in holds for name, value in probability.items())
    axes.set(xlim=(0, 1), xlabel=words + (" (grey: the verdict refuses it)" if refused else ""))
    axes.tick_params(labelsize=8)
