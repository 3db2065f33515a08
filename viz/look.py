"""A contact sheet of a clip with what may be a body in it, numbered, so that one can be chosen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from viz.overlay import BODY_COLOURS, MAX_SIDE, shrink

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS = 6
ACROSS = {True: 3, False: 6}  # panels in a row, of wide pictures and of tall ones
ROOM = 1.6  # radii of a thing, at which its ring is drawn
LEAST = 0.015  # of the picture's longer side, that a ring measures at least


def look_sheet(
    frames: Any, numbers: np.ndarray, times: np.ndarray, places: np.ndarray, size: np.ndarray
) -> Figure:
    """Frames of a clip with a numbered ring around each thing that moves, and its way as a line.

    Args:
        frames: ``(t, H, W, 3)``, bytes.
        numbers: of the frames in the clip, ``(t,)``.
        times: seconds, ``(t,)``.
        places: of k things, pixels (column, row), ``(t, k, 2)``; NaN where one is not seen.
        size: their radii, pixels, ``(k,)``.
    """
    from matplotlib.figure import Figure

    height, width = frames.shape[1:3]
    columns = ACROSS[width > height]
    rows = -(-PANELS // columns)
    wide = 13 / columns
    figure = Figure(
        figsize=(13, rows * (wide * height / width + 0.45) + 0.3), layout="constrained", dpi=110
    )
    axes: Any = figure.subplots(rows, columns, squeeze=False)
    shown = np.flatnonzero(np.isfinite(places).any((1, 2)))
    evenly = np.linspace(0, len(shown) - 1, PANELS + 2)[1:-1].round().astype(int)
    chosen = shown[np.unique(evenly)] if len(shown) else [0]
    for panel in axes.flat:
        panel.set_axis_off()
    for panel, k in zip(axes.flat, chosen, strict=False):
        _panel(panel, frames[k], places, size, int(k))
        panel.set_title(f"frame {numbers[k]} ({times[k]:.2f} s)", fontsize=9)
    return figure


def _panel(axes: Axes, frame: np.ndarray, places: np.ndarray, size: np.ndarray, k: int) -> None:
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    height, width = frame.shape[:2]
    axes.set_axis_on()
    small = shrink(frame, -(-max(height, width) // MAX_SIDE))
    axes.imshow(small, extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    edge = [withStroke(linewidth=3, foreground="black")]
    for n in reversed(range(places.shape[1])):  # the likeliest on top
        colour = tuple(part / 255 for part in BODY_COLOURS[n % len(BODY_COLOURS)])
        axes.plot(*places[:, n].T, color=colour, lw=0.8, alpha=0.7)
        if not np.isfinite(places[k, n]).all():
            continue
        radius = max(ROOM * size[n], LEAST * max(height, width))
        ring = Circle(tuple(places[k, n]), radius, fill=False, ec=colour, lw=1.8, path_effects=edge)
        axes.add_patch(ring)
        way = -1 if n % 2 else 1  # numbers of neighbours do not lie on each other
        x, y = places[k, n] + [way * radius, -radius]
        x, y = np.clip([x, y], 0.03 * width, [0.97 * width, 0.96 * height])
        said = axes.text(x, y, str(n + 1), color=colour, ha="center", va="center")
        said.set(fontsize=12, weight="bold", path_effects=edge)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    axes.tick_params(labelsize=6, length=2)
