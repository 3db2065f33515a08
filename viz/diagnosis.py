"""One page on a diagnosis: what was seen and foretold, and how likely each term is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from viz.legend import named_handles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SEEN, MODEL, TAIL = "#777777", "#0072B2", "#D55E00"
CHANGED = ("#009E73", "#CC79A7")
WALL = "#222222"
MOST_SERIES = 4  # coordinates that are drawn


def diagnosis_figure(
    times: np.ndarray,
    positions: np.ndarray,
    probability: Mapping[str, float],
    rolled: Mapping[str, tuple[np.ndarray, np.ndarray]],
    wall: Mapping[str, Any] | None = None,
) -> Figure:
    """Tracks with the model's continuation above, probabilities of the terms below.

    Args:
        times: seconds, ``(t,)``.
        positions: ``(t, n, d)``, NaN where not seen.
        probability: of each term, by name.
        rolled: times and positions by name; ``model`` first, then changed laws.
        wall: the ``axis`` and ``place`` of one that the only body strikes.
    """
    import matplotlib
    from matplotlib.figure import Figure

    series, names = positions.reshape(len(times), -1), _names(*positions.shape[1:])
    rows = min(series.shape[1], MOST_SERIES)
    with matplotlib.rc_context({"font.size": 10, "axes.edgecolor": "#bbbbbb"}):
        figure = Figure(figsize=(10, 1.9 * rows + 3.0), layout="constrained")
        axes: Any = figure.subplots(rows + 1, 1, height_ratios=[*[1.9] * rows, 2.2])
        for k in range(rows):
            _path(axes[k], times, series[:, k], rolled, k)
            axes[k].set_ylabel(names[k])
            axes[k].sharex(axes[0])
            if wall is not None and names[k] == wall["axis"]:
                axes[k].axhline(wall["place"], color=WALL, lw=1, zorder=0, label="wall")
        handles, labels = named_handles(axes[:rows])
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
        axes[rows - 1].set_xlabel("seconds")
        _terms(axes[rows], probability, wall is not None)
    return figure


def _names(bodies: int, space: int) -> list[str]:
    """Of the coordinates, in the order of the tracks' columns."""
    numbers = [""] if bodies == 1 else [str(body) for body in range(1, bodies + 1)]
    return [axis + number for number in numbers for axis in "xyz"[:space]]


def _path(
    axes: Axes,
    times: np.ndarray,
    seen: np.ndarray,
    rolled: Mapping[str, tuple[np.ndarray, np.ndarray]],
    column: int,
) -> None:
    axes.plot(times, seen, ".", color=SEEN, ms=3, label="recorded")
    colours = iter(CHANGED)
    for name, (when, path) in rolled.items():
        own = path.reshape(len(when), -1)[:, column]
        if name == "model":
            axes.plot(when, own, color=TAIL, lw=1.6, label="model, not fitted to these")
            axes.axvline(when[0], color="#bbbbbb", lw=1)
        else:
            axes.plot(when, own, color=next(colours, SEEN), lw=1, ls="--", label=name)
    axes.tick_params(labelsize=8)


def _terms(axes: Axes, probability: Mapping[str, float], beside_a_wall: bool) -> None:
    names = list(probability)
    values = [probability[name] for name in names]
    axes.barh(names, values, color=MODEL)
    axes.invert_yaxis()
    which = ", if there were no wall" if beside_a_wall else ""
    axes.set(xlim=(0, 1), xlabel=f"probability that the scene has the term{which}")
    axes.tick_params(labelsize=8)
