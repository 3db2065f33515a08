"""One page on a diagnosis: what was seen, what the model says of it, and what it leaves."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from viz.legend import named_handles
from viz.overlay import BODY_COLOURS, MAX_SIDE, shrink

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SEEN, MODEL, TAIL = "#777777", "#0072B2", "#D55E00"
CHANGED = ("#009E73", "#CC79A7")
LEFT = ("#000000", "#E69F00", "#56B4E9", "#009E73")
WALL, HELD = "#222222", "#f3ece4"
MOST_SERIES = 4  # coordinates that are drawn
WRAP = 130  # letters of a line above
INSIDE = 98  # per cent of what is left, that is drawn; outliers would hide it
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
) -> Figure:
    """Each coordinate with the model, what it leaves, and the way of the bodies beside them.

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
    """
    import matplotlib
    from matplotlib.figure import Figure

    series, names = positions.reshape(len(times), -1), _names(*positions.shape[1:])
    rows = min(series.shape[1], MOST_SERIES)
    plane = positions.shape[2] == 2
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": "#bbbbbb"}):
        figure = Figure(figsize=(13, 1.6 * (rows + 1) + 1.6), layout="constrained")
        sides: Any = (
            figure.subfigures(1, 2, width_ratios=[1.7, 1])
            if plane or probability
            else [figure.subfigures(1, 1)]
        )
        axes: Any = sides[0].subplots(rows + 1, 1, sharex=True)
        for k in range(rows):
            _path(axes[k], times, series[:, k], rolled, path, k)
            axes[k].set_ylabel(_in(names[k], unit))
            if wall is not None and names[k] == wall["axis"]:
                axes[k].axhline(wall["place"], color=WALL, lw=1, zorder=0, label="wall")
        _left(axes[rows], times, series, names, path or rolled.get("model"), unit)
        if "model" in rolled:
            first, last = rolled["model"][0][[0, -1]]
            for panel in axes:
                panel.axvspan(first, last, color=HELD, zorder=-1, lw=0, label="held out")
        handles, labels = named_handles(axes[:rows])
        sides[0].legend(
            handles, labels, loc="outside upper center", ncols=len(labels), frameon=False
        )
        axes[rows].set_xlabel("seconds")
        if len(sides) > 1:
            _beside(sides[1], positions, path or rolled.get("model"), unit, picture, probability)
        _say(figure, said)
    return figure


def _say(figure: Figure, said: Sequence[str]) -> None:
    if said:
        lines = [part for line in said for part in textwrap.wrap(line, WRAP)]
        figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=10)


def _in(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


def _names(bodies: int, space: int) -> list[str]:
    """Of the coordinates, in the order of the tracks' columns."""
    numbers = [""] if bodies == 1 else [str(body) for body in range(1, bodies + 1)]
    return [axis + number for number in numbers for axis in "xyz"[:space]]


def _path(
    axes: Axes,
    times: np.ndarray,
    seen: np.ndarray,
    rolled: Mapping[str, Path],
    path: Path | None,
    column: int,
) -> None:
    axes.plot(times, seen, ".", color=SEEN, ms=3, label="recorded")
    low, high = np.nanmin(seen), np.nanmax(seen)
    colours = iter(CHANGED)
    if path is not None:
        axes.plot(path[0], _column(path, column), color=MODEL, lw=1.2, label="model")
    for name, one in rolled.items():
        if name == "model":
            axes.plot(one[0], _column(one, column), color=TAIL, lw=1.6, label="model, foretold")
        else:
            colour = next(colours, SEEN)
            axes.plot(one[0], _column(one, column), color=colour, lw=1, ls="--", label=name)
    room = 0.3 * (high - low)  # a changed law may go far
    if room > 0:
        axes.set_ylim(max(axes.get_ylim()[0], low - room), min(axes.get_ylim()[1], high + room))
    axes.tick_params(labelsize=8)


def _column(path: Path, column: int) -> np.ndarray:
    return path[1].reshape(len(path[0]), -1)[:, column]


def _left(
    axes: Axes,
    times: np.ndarray,
    series: np.ndarray,
    names: list[str],
    path: Path | None,
    unit: str,
) -> None:
    """What the model leaves of every coordinate."""
    axes.set_ylabel(_in("recorded − model", unit))
    axes.axhline(0, color=SEEN, lw=0.8)
    axes.tick_params(labelsize=8)
    if path is None:
        return
    first = int(np.searchsorted(times, path[0][0] - 1e-9))
    left = series[first : first + len(path[0])] - path[1].reshape(len(path[0]), -1)
    for k, name in enumerate(names):
        axes.plot(path[0], left[:, k], ".", ms=3, color=LEFT[k % len(LEFT)], label=name)
    axes.legend(loc="upper right", ncols=len(names), fontsize=8, markerscale=2)
    most = 1.4 * float(np.nanpercentile(np.abs(left), INSIDE))
    if most > 0:
        axes.set_ylim(-most, most)


def _beside(
    side: Any,
    positions: np.ndarray,
    path: Path | None,
    unit: str,
    picture: tuple[np.ndarray, float] | None,
    probability: Mapping[str, float] | None,
) -> None:
    """The way in the plane, and below it how likely each term is."""
    plane = positions.shape[2] == 2
    panels: Any = side.subplots(plane + bool(probability), 1, squeeze=False)[:, 0]
    if plane:
        _way(panels[0], positions, path, unit, picture)
    if probability:
        _terms(panels[-1], probability)


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
        colour = tuple(part / 255 for part in BODY_COLOURS[n % len(BODY_COLOURS)])
        name = f"body {n + 1}" if positions.shape[1] > 1 else "recorded"
        axes.plot(*positions[:, n].T, ".", color=colour, ms=3, label=name)
        if path is not None:
            said = "model" if n == 0 else None
            axes.plot(*path[1][:, n].T, color=MODEL, lw=0.8, label=said)
    axes.set(aspect="equal", xlabel=_in("x", unit), ylabel=_in("y", unit))
    axes.legend(loc="best", fontsize=8)
    axes.tick_params(labelsize=8)


def _terms(axes: Axes, probability: Mapping[str, float]) -> None:
    axes.barh(list(probability), list(probability.values()), color=MODEL)
    axes.invert_yaxis()
    axes.set(xlim=(0, 1), xlabel="probability that the scene has the term")
    axes.tick_params(labelsize=8)
