"""How the viewer arranges a recording: the layouts, as code, that each recording embeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from viz.overlay import energy_range, picture_factor
from viz.showcase import ROLES, Arrays, zoom_extent

if TYPE_CHECKING:
    import rerun.blueprint as rrb


def showcase_layout(showcase: Arrays) -> rrb.Blueprint:
    """What was observed, the trained law and the flipped one side by side, energies below."""
    import rerun.blueprint as rrb

    starts = [float(showcase[key][0]) for key in ("times", "frame_times") if key in showcase]
    first, last = min(starts), float(showcase["times"][-1])
    window = (max(first, -0.2 * last), last)
    zoom = zoom_extent(showcase)
    square = rrb.VisualBounds2D(x_range=(-zoom, zoom), y_range=(-zoom, zoom))

    def world(name: str, *roles: str) -> rrb.Spatial2DView:
        entities = [f"world/{role}" for role in ("context", *roles)]
        contents = [f"+ /{entity}/**" for entity in entities]
        return rrb.Spatial2DView(
            origin="/",
            contents=contents,
            name=name,
            visual_bounds=square,
            overrides={f"{entity}/trail": growing() for entity in entities},
        )

    about = rrb.TextDocumentView(origin="/about", name="About")
    left: list[rrb.View] = [about]
    if "frames" in showcase:
        camera = rrb.Spatial2DView(
            origin="/camera",
            name="What was observed, and the track",
            visual_bounds=_whole_picture(showcase["frame_times"], showcase["frames"]),
            overrides={"camera/track/trail": growing()},
        )
        left = [camera, about]
    plots: list[rrb.View | rrb.Container] = [
        _plot("log10 |E - E0| / |E0|", [f"energy_error/{role}" for role in ROLES], window),
        _energies("Energy, the trained law", showcase, ("truth", "prediction"), window),
        _energies(
            "Energy, the coupling flipped",
            showcase,
            ("counterfactual_truth", "counterfactual"),
            window,
        ),
    ]
    if "energy_long" in showcase:
        end = (0.0, float(showcase["long_times"][-1]))
        long = _energies("Energy, the long rollout", showcase, ("long",), end)
        plots[0] = rrb.Tabs(plots[0], long)
    worlds = rrb.Horizontal(
        rrb.Tabs(*left),
        world("The trained law", "truth", "prediction"),
        world("What if the coupling flips", "counterfactual_truth", "counterfactual"),
    )
    phase = rrb.StateTimelineView(origin="/phase", name="Phase")
    rows = rrb.Vertical(worlds, rrb.Horizontal(*plots), phase, row_shares=[10, 7, 2])
    # The list of recordings stays open: cells are there to be compared.
    panels = rrb.BlueprintPanel(state="expanded"), rrb.SelectionPanel(state="collapsed")
    return rrb.Blueprint(rows, clock((first, last)), *panels)


def overlay_layout(video: Arrays) -> rrb.Blueprint:
    """The clip with what is drawn over it, beside the positions in time."""
    import rerun.blueprint as rrb

    roles = ("observed", "readout", "rollout", "changed")
    picture = rrb.Spatial2DView(
        origin="/video",
        name="Observed, read out, rolled out",
        visual_bounds=_whole_picture(video["frame_times"], video["frames"]),
        overrides={f"video/{role}/trail": growing(seconds=1.0) for role in roles},
    )
    lines = [_plot(f"{n}(t), world units", [f"position_{n}/{r}" for r in roles]) for n in "xy"]
    phase = rrb.StateTimelineView(origin="/phase", name="Phase")
    about = rrb.TextDocumentView(origin="/about", name="About")
    right = rrb.Vertical(*lines, phase, about, row_shares=[5, 5, 2, 3])
    columns = rrb.Horizontal(picture, right, column_shares=[2, 3])
    return rrb.Blueprint(columns, clock(), collapse_panels=True)


def rolled_layout(
    roles: Sequence[str],
    centre: tuple[float, float],
    half: float,
    last: float,
    energies: tuple[float, float] | None,
) -> rrb.Blueprint:
    """One episode large, with what is said of it; energies below.

    Args:
        roles: that are there.
        centre: of the square that is shown.
        half: of its side.
        last: instant, seconds.
        energies: ends of their axis; none are shown where it is ``None``.
    """
    import rerun.blueprint as rrb

    x, y = centre
    square = rrb.VisualBounds2D(x_range=(x - half, x + half), y_range=(-y - half, half - y))
    world = rrb.Spatial2DView(
        origin="/",
        contents=[f"+ /world/{role}/**" for role in roles],
        name="The episode",
        visual_bounds=square,
        overrides={f"world/{role}/trail": growing() for role in roles},
    )
    about = rrb.TextDocumentView(origin="/about", name="About")
    above = rrb.Horizontal(world, about, column_shares=[3, 2])
    phase = rrb.StateTimelineView(origin="/phase", name="Phase")
    if energies is None:
        rows = rrb.Vertical(above, phase, row_shares=[10, 2])
    else:
        names = [f"energy/{role}" for role in ("truth", "model", "own")]
        rows = rrb.Vertical(
            above, _plot("Energy", names, (0.0, last), energies), phase, row_shares=[10, 5, 2]
        )
    panels = rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed")
    return rrb.Blueprint(rows, clock((0.0, last)), *panels)


def _whole_picture(times: np.ndarray, frames: np.ndarray) -> rrb.VisualBounds2D:
    import rerun.blueprint as rrb

    height, width = (side // picture_factor(times, frames) for side in frames.shape[1:3])
    return rrb.VisualBounds2D(x_range=(0, width), y_range=(0, height))


def _energies(
    name: str, showcase: Arrays, roles: Sequence[str], window: tuple[float, float]
) -> rrb.TimeSeriesView:
    """Energies on an axis that does not make a plunge of a thousandth."""
    values = np.concatenate([np.ravel(showcase[f"energy_{role}"]) for role in roles])
    values = values[np.isfinite(values)]
    ends = energy_range(float(values.min()), float(values.max())) if len(values) else None
    return _plot(name, [f"energy/{role}" for role in roles], window, ends)


def _plot(
    name: str,
    entities: Sequence[str],
    window: tuple[float, float] | None = None,
    values: tuple[float, float] | None = None,
) -> rrb.TimeSeriesView:
    import rerun as rr
    import rerun.blueprint as rrb

    axis = None
    if window is not None:
        start, end = (rr.TimeRangeBoundary.absolute(seconds=edge) for edge in window)
        axis = rrb.TimeAxis(link="independent", view_range=rr.TimeRange(start=start, end=end))
    contents = [f"+ /{entity}" for entity in entities]
    height = None if values is None else rrb.ScalarAxis(range=values)
    return rrb.TimeSeriesView(origin="/", contents=contents, name=name, axis_x=axis, axis_y=height)


def growing(
    seconds: float | None = None,
) -> tuple[rrb.VisibleTimeRanges | rrb.Visualizer, ...]:
    """Show a trail's pieces of the past (of the last ``seconds``), not of the present alone."""
    import rerun as rr
    import rerun.blueprint as rrb

    edge = rr.TimeRangeBoundary
    begin = edge.infinite() if seconds is None else edge.cursor_relative(seconds=-seconds)
    span = rrb.VisibleTimeRanges(
        timeline="sim_time", start=begin, end=edge.cursor_relative(seconds=0.0)
    )
    return span, rr.LineStrips2D.from_fields().visualizer()


def clock(window: tuple[float, float] | None = None) -> rrb.TimePanel:
    """Of a recording; a window (seconds) is passed in eight seconds, again and again."""
    import rerun as rr
    import rerun.blueprint as rrb

    if window is None:
        return rrb.TimePanel(timeline="sim_time", state="collapsed", loop_mode="all")
    seconds = window[1] - window[0]
    start, end = (rr.TimeInt(seconds=edge) for edge in window)
    return rrb.TimePanel(
        timeline="sim_time",
        state="collapsed",
        playback_speed=seconds / 8,  # one pass takes eight seconds
        loop_mode="selection",
        time_selection=rrb.components.AbsoluteTimeRange(min=start, max=end),
    )
