"""Figures of an atlas: the heat map over depth, and cost beside accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from viz.figures import _TEXT, FAINT, INK, SPARE, STYLES
from viz.sweeps import plain_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CELL = 0.52  # inches
MARKS = (*STYLES.values(), *SPARE)
LIGHT = 0.55  # scores above it are dark print on a light ground


@dataclass(frozen=True)
class Layer:
    """A column of the map; ``cost`` is in ms a clip."""

    encoder: str
    name: str
    depth: float
    cost: float


@dataclass(frozen=True)
class Spot:
    """A cell of the map: what a layer knows of a target, by the records' names of numbers."""

    encoder: str
    layer: str
    target: str
    numbers: Mapping[str, float]


def depth_map(
    layers: Sequence[Layer], spots: Sequence[Spot], best: Mapping[str, tuple[str, str]]
) -> Figure:
    """Scores of every layer and target: a block for each encoder, from its first to its last.

    Args:
        layers: in order of depth within their encoder.
        spots: the cells.
        best: encoder and layer that know most, by target.
    """
    import matplotlib
    from matplotlib.figure import Figure

    encoders = list(dict.fromkeys(layer.encoder for layer in layers))
    targets = list(dict.fromkeys(spot.target for spot in spots))
    widths = [sum(layer.encoder == name for layer in layers) for name in encoders]
    with matplotlib.rc_context(_TEXT):
        size = (CELL * sum(widths) + 0.35 * len(widths) + 2.4, CELL * len(targets) + 1.7)
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(1, len(encoders), squeeze=False, sharey=True, width_ratios=widths)[
            0
        ]
    for axes, name in zip(panels, encoders, strict=True):
        mine = [layer for layer in layers if layer.encoder == name]
        drawn = _block(axes, mine, targets, spots, best)
        axes.set_title(name, fontsize=9, loc="left")
    panels[0].set_yticks(range(len(targets)), targets)
    figure.colorbar(drawn, ax=list(panels), label="score", shrink=0.8)
    return figure


def _block(
    axes: Axes,
    layers: Sequence[Layer],
    targets: Sequence[str],
    spots: Sequence[Spot],
    best: Mapping[str, tuple[str, str]],
) -> Any:
    from matplotlib.patches import Rectangle

    names = [layer.name for layer in layers]
    values = [[float("nan")] * len(names) for _ in targets]
    for spot in spots:
        if spot.encoder != layers[0].encoder:
            continue
        row, column = targets.index(spot.target), names.index(spot.layer)
        score = spot.numbers["score"]
        values[row][column] = score
        sure = min(spot.numbers["selectivity_low"], spot.numbers["score_low"]) > 0
        ink = INK if score > LIGHT else "white"
        axes.text(column, row, f"{score:.2f}", ha="center", va="center", fontsize=7, color=ink)
        if sure:
            axes.plot(column, row + 0.34, "o", ms=2.8, color=ink)
        if best.get(spot.target) == (spot.encoder, spot.layer):
            frame = Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, ec="#D55E00", lw=2)
            axes.add_patch(frame)
    drawn = axes.imshow(values, vmin=0, vmax=1, cmap="viridis", aspect="auto")
    labels = [f"{layer.name}\n{layer.cost:.3g} ms" for layer in layers]
    axes.set_xticks(range(len(names)), labels, fontsize=6.5, rotation=60, ha="right")
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    return drawn


def cost_figure(
    layers: Sequence[Layer],
    spots: Sequence[Spot],
    fronts: Mapping[str, Sequence[tuple[str, str]]],
) -> Figure:
    """Score against ms a clip, a panel for each target, the front drawn through what is on it."""
    import matplotlib
    from matplotlib.figure import Figure

    encoders = list(dict.fromkeys(layer.encoder for layer in layers))
    costs = {(layer.encoder, layer.name): layer.cost for layer in layers}
    targets = list(fronts)
    columns = min(3, len(targets))
    rows = -(-len(targets) // columns)
    with matplotlib.rc_context(_TEXT):
        figure = Figure(figsize=(3.6 * columns, 2.6 * rows + 0.5), layout="constrained")
        panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in panels[len(targets) :]:
        axes.set_visible(False)
    for axes in panels[::columns]:
        axes.set_ylabel("score")
    for axes, target in zip(panels, targets, strict=False):
        mine = {(s.encoder, s.layer): s for s in spots if s.target == target}
        for number, name in enumerate(encoders):
            colour, marker = MARKS[number % len(MARKS)]
            own = [key for key in mine if key[0] == name]
            scores = [mine[key].numbers["score"] for key in own]
            at = [costs[key] for key in own]
            axes.plot(at, scores, marker, color=colour, ms=4, label=name)
        front = sorted((costs[key], mine[key].numbers["score"]) for key in fronts[target])
        axes.step(*zip(*front, strict=True), where="post", color=INK, lw=1, alpha=0.6)
        axes.axhline(_rival(mine.values()), color=FAINT, lw=0.8, ls=":")
        axes.set(xscale="log", xlabel="ms a clip")
        plain_ticks(axes, "x")
        axes.set_title(target, fontsize=9, loc="left")
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return figure


def _rival(spots: Any) -> float:
    """The score of pixels, which is the same beside every layer."""
    return next(iter(spots)).numbers.get("control/pixels", 0.0)
