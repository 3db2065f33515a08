"""World positions over pictures: pixel coordinates, picture sizes, and the contact sheet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from viz.showcase import (
    ROLES,
    Arrays,
    check_showcase,
    context,
    half_extent,
    laws_of,
    zoom_extent,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase, SubFigure

MAX_SIDE = 640  # pixels; larger pictures are shrunk by a whole factor
MAX_RAW_SIDE = 128  # the same, for larger ones that cannot be compressed
SMALL_SIDE = 256  # pixels, below which a picture is stored as it is: JPEG damages small bodies
LEAST_RANGE = 0.2  # of an axis of energy, as a share of the energy
# Okabe and Ito's palette: told apart with every common kind of colour vision.
BODY_COLOURS = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (204, 121, 167),
    (213, 94, 0),
    (0, 114, 178),
)
GUESS_COLOURS = {"prediction": "#0072B2", "counterfactual": "#D55E00"}
# Of a contact sheet's parts, in shares of them; an automatic layout draws everything three times.
STRIP = {"left": 0.01, "right": 0.99, "bottom": 0.0, "top": 0.72}
SPACED = 1.3  # sides of a frame from one to the next
PANELS = {"left": 0.04, "right": 0.86, "bottom": 0.15, "top": 0.91, "wspace": 0.25, "hspace": 0.22}


def world_to_pixel(positions: np.ndarray, size: tuple[int, int], half_extent: float) -> np.ndarray:
    """Pixel coordinates (u to the right, v downwards, origin at the image's top left corner).

    Args:
        positions: ``(..., 2)``, world units, y upwards, origin at the image centre.
        size: pixels (height, width).
        half_extent: world length of half of the longer image side.
    """
    height, width = size
    scale = max(height, width) / 2 / half_extent
    x, y = np.moveaxis(np.asarray(positions, np.float64), -1, 0)
    return np.stack([width / 2 + scale * x, height / 2 - scale * y], axis=-1)


def stored_as_jpeg(times: np.ndarray, frames: np.ndarray) -> bool:
    """Whether frames ``(F, H, W, 3)`` at ``times`` (seconds) are compressed: large, and can be."""
    # Viewer 0.41 shows no encoded picture (JPEG or PNG) at a negative time, but raw ones.
    return bool(np.min(times) >= 0) and max(frames.shape[1:3]) >= SMALL_SIDE


def picture_factor(times: np.ndarray, frames: np.ndarray) -> int:
    """The whole factor by which frames ``(F, H, W, 3)`` are shrunk to fit the cap."""
    side = max(frames.shape[1:3])
    if side < SMALL_SIDE:
        return 1
    return -(-side // (MAX_SIDE if stored_as_jpeg(times, frames) else MAX_RAW_SIDE))


def energy_range(low: float, high: float) -> tuple[float, float]:
    """Ends of an axis of energy, as wide as a share of the energy at least.

    A drift of less than a thousandth would fill the picture, and look like a plunge.
    """
    centre, half = (low + high) / 2, (high - low) / 2
    least = LEAST_RANGE * max(abs(low), abs(high)) / 2
    return centre - max(half, least), centre + max(half, least)


def shrink(picture: np.ndarray, factor: int) -> np.ndarray:
    """Average ``factor`` by ``factor`` pixels of a uint8 picture ``(H, W, 3)``."""
    from PIL import Image

    if factor == 1:
        return picture
    rows, columns = (side // factor for side in picture.shape[:2])
    cut = Image.fromarray(picture[: rows * factor, : columns * factor])
    return np.asarray(cut.reduce(factor))


def contact_sheet(showcase: Arrays, meta: Mapping[str, str]) -> Figure:
    """One episode on a page: frames with the track, paths under both laws, energies.

    Args:
        showcase: the arrays of a cell, as :func:`viz.recording.write_recording` takes them.
        meta: what is shown, in words; ``cell`` becomes the title.

    Raises:
        ValueError: an array is missing or has the wrong shape.
    """
    import matplotlib
    from matplotlib.figure import Figure

    check_showcase(showcase)
    pictures = "frames" in showcase
    with matplotlib.rc_context({"font.size": 10, "axes.edgecolor": "#bbbbbb"}):
        figure = Figure(figsize=(11, 5.6 if pictures else 4.1))
        below: FigureBase = figure
        if pictures:
            parts: Any = figure.subfigures(2, 1, height_ratios=[1, 2.4], hspace=0)
            _film_strip(parts[0], showcase)
            below = parts[1]
        panels = below.subplot_mosaic(
            [["law", "flip", "energy"], ["law", "flip", "error"]], gridspec_kw=PANELS
        )
        _paths(panels["law"], showcase, "truth", "prediction", "The trained law")
        roles = ("counterfactual_truth", "counterfactual")
        _paths(panels["flip"], showcase, *roles, "What if the coupling flips")
        _energies(panels["energy"], panels["error"], showcase, laws_of(meta))
        figure.suptitle(meta.get("cell", ""), x=0.01, ha="left", fontsize=12, weight="bold")
    return figure


def _film_strip(part: SubFigure, showcase: Arrays) -> None:
    """Up to eight frames, evenly spaced, each with the track up to that moment.

    All in one system of axes: each of their own would take a third of the sheet's time.
    """
    from matplotlib.patches import Rectangle

    frames, times = showcase["frames"], showcase["frame_times"]
    chosen = np.unique(np.linspace(0, len(frames) - 1, 8).round().astype(int))
    height, width = frames.shape[1:3]
    extent = half_extent(showcase)
    track = world_to_pixel(showcase["track"], (height, width), extent)
    zoom = min(extent, 1.25 * zoom_extent(showcase))
    corner = world_to_pixel(np.array([[-zoom, zoom], [zoom, -zoom]]), (height, width), extent)
    (left, top), (right, bottom) = corner
    side, pitch = right - left, SPACED * (right - left)
    axes = part.subplots(gridspec_kw=STRIP)
    for place, k in enumerate(chosen):
        move = np.array([place * pitch, 0.0])
        box = Rectangle(corner[0] + move, side, bottom - top, fc="none", ec="#bbbbbb", zorder=3)
        axes.add_patch(box)
        span = (move[0], move[0] + width, height, 0)
        drawn: list[Any] = [axes.imshow(frames[k], extent=span, interpolation="nearest")]
        for n in range(track.shape[1]):
            colour = tuple(part / 255 for part in BODY_COLOURS[n % len(BODY_COLOURS)])
            path, at = (track[: k + 1, n] + move).T, track[k, n] + move
            drawn += axes.plot(*path, color=colour, lw=1)
            drawn += axes.plot(*at, "o", color=colour, ms=3.5, mec="white", mew=0.6)
        for artist in drawn:
            artist.set_clip_path(box)
        middle = left + move[0] + side / 2
        axes.text(middle, top - 0.08 * side, f"{times[k]:+.2f} s", fontsize=9, ha="center")
    end = left + (len(chosen) - 1) * pitch + side
    axes.set(xlim=(left - 0.1 * side, end + 0.1 * side), ylim=(bottom, top))
    axes.set_axis_off()


def _paths(axes: Axes, showcase: Arrays, truth: str, guess: str, title: str) -> None:
    after = np.asarray(showcase["times"]) >= 0
    _, past = context(showcase)
    for n in range(np.shape(showcase[truth])[1]):
        real, told = (np.asarray(showcase[key])[after, n].T for key in (truth, guess))
        first = n == 0
        axes.plot(*past[:, n].T, color="#767676", lw=1, ls=":", label="observed" if first else None)
        axes.plot(*real, color="#8e8e8e", lw=4, label="truth" if first else None)
        axes.plot(*told, color=GUESS_COLOURS[guess], lw=1.6, label=guess if first else None)
        axes.plot(*real[:, :1], "o", color="#444444", ms=4)
    # One box for both laws, around what truly happens: a diverging prediction leaves it.
    both = [np.asarray(showcase[key])[after] for key in ("truth", "counterfactual_truth")]
    low, high = np.nanmin(both, axis=(0, 1, 2)), np.nanmax(both, axis=(0, 1, 2))
    centre, half = (low + high) / 2, 0.65 * float(np.max(high - low))
    box = np.stack([centre - half, centre + half])
    axes.set(xlim=box[:, 0], ylim=box[:, 1], aspect="equal", title=title)
    axes.tick_params(labelsize=8)
    below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.08), "ncols": 3}
    axes.legend(**below, fontsize=8, frameon=False)


def _energies(upper: Axes, lower: Axes, showcase: Arrays, names: Mapping[str, str]) -> None:
    times = np.asarray(showcase["times"])
    after = times >= 0
    for role in ROLES:
        energy = np.asarray(showcase[f"energy_{role}"], np.float64)[after]
        with np.errstate(all="ignore"):
            error = np.abs(energy - energy[0]) / np.abs(energy[0])
        real = role.endswith("truth")
        look: dict[str, Any] = {
            "color": GUESS_COLOURS.get(role, "#8e8e8e"),
            "ls": "--" if role.startswith("counterfactual") else "-",
            "lw": 4 if real else 1.6,
        }
        upper.plot(times[after], energy, label=names[role], **look)
        lower.plot(times[after], np.where(error > 0, error, np.nan), **look)
    upper.set(title="Energy", xticklabels=[], ylim=energy_range(*upper.get_ylim()))
    upper.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)
    lower.set(yscale="log", xlabel="seconds since the law may change")
    lower.set_title("|E − E0| / |E0|", fontsize=9, loc="left", pad=3)
    lower.minorticks_off()
    lower.yaxis.set_major_formatter(lambda value, _: f"{value:g}")  # powers take long to set
    for axes in (upper, lower):
        axes.tick_params(labelsize=8)
