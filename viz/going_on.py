"""How a recording goes on: what was recorded, what a model foretells, and that under other laws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from viz.diagnosis import CHANGED, HELD, HUES, Path, darker
from viz.legend import named_handles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORETOLD = "foretold"
AWAY = 0.4  # of the extent of what was recorded and foretold, that another law may go beyond it


def going_on_figure(times: np.ndarray, seen: np.ndarray, rolled: Mapping[str, Path]) -> Figure:
    """Every body along each axis in time, and beside it its way in the plane, where there is one.

    Args:
        times: of what was recorded, seconds, ``(t,)``.
        seen: ``(t, n, d)``, NaN where not seen.
        rolled: times and places by the words of the law; what is foretold first.
    """
    import matplotlib
    from matplotlib.figure import Figure

    space = seen.shape[2]
    names: Any = [[f"{name}(t)", *["way"][: space == 2]] for name in "xyz"[:space]]
    sizes: Any = {"width_ratios": [1.7, 1]} if space == 2 else {}
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": "#bbbbbb"}):
        figure = Figure(figsize=(13, 2.1 * space + 1.2), layout="constrained")
        panels: Any = figure.subplot_mosaic(names, **sizes)
        along = [panels[row[0]] for row in names]
        for k, axes in enumerate(along):
            _along(axes, times, seen[..., k], {x: (t, q[..., k]) for x, (t, q) in rolled.items()})
            axes.set_ylabel("xyz"[k])
            axes.sharex(along[0])
        along[-1].set_xlabel("seconds")
        if space == 2:
            _way(panels["way"], seen, rolled)
        handles, labels = named_handles(along)
        figure.legend(handles, labels, loc="outside upper left", ncols=8, frameon=False)
    return figure


def _along(axes: Axes, times: np.ndarray, seen: np.ndarray, rolled: Mapping[str, Path]) -> None:
    for n in range(seen.shape[1]):
        name = f"body {n + 1}, recorded" if seen.shape[1] > 1 else "recorded"
        axes.plot(times, seen[:, n], ".", color=HUES[n % len(HUES)], ms=4, label=name)
        for law, (when, places) in rolled.items():
            axes.plot(when, places[:, n], label=law, **_look(n, law, rolled))
    start, end = rolled[FORETOLD][0][[0, -1]]
    axes.axvspan(start, end, color=HELD, zorder=-1, lw=0)
    axes.set_ylim(*_ends(seen, rolled[FORETOLD][1], axes.get_ylim()))


def _way(axes: Axes, seen: np.ndarray, rolled: Mapping[str, Path]) -> None:
    for n in range(seen.shape[1]):
        axes.plot(*seen[:, n].T, ".", color=HUES[n % len(HUES)], ms=4)
        for law, (_, places) in rolled.items():
            axes.plot(*places[:, n].T, **_look(n, law, rolled))
    foretold = rolled[FORETOLD][1]
    axes.set(xlabel="x", ylabel="y")
    axes.set_xlim(*_ends(seen[..., 0], foretold[..., 0], axes.get_xlim()))
    axes.set_ylim(*_ends(seen[..., 1], foretold[..., 1], axes.get_ylim()))
    axes.set_aspect("equal", adjustable="box")


def _look(body: int, law: str, rolled: Mapping[str, Path]) -> dict[str, Any]:
    hue = HUES[body % len(HUES)]
    if law == FORETOLD:
        return {"color": darker(hue), "lw": 1.8}
    return {"color": hue, "lw": 1.2, "ls": CHANGED[(list(rolled).index(law) - 1) % len(CHANGED)]}


def _ends(seen: np.ndarray, foretold: np.ndarray, drawn: tuple[float, float]) -> Any:
    """Of an axis: all that was recorded and foretold, and so much of what lies beyond."""
    both = np.concatenate([seen.ravel(), foretold.ravel()])
    both = both[np.isfinite(both)]
    if not len(both):
        return drawn
    low, high = float(both.min()), float(both.max())
    room = AWAY * (high - low)
    return max(drawn[0], low - room), min(drawn[1], high + room)
