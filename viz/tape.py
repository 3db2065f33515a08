"""How each kind of array is stored in a recording: bodies, energies, pictures, phases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from viz.overlay import BODY_COLOURS, picture_factor, shrink, stored_as_jpeg
from viz.whole import whole

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

Colour = tuple[int, int, int]
COLOURS: dict[str, Colour] = {
    "context": (110, 110, 110),
    "truth": (150, 150, 150),
    "prediction": (86, 180, 233),
    "counterfactual_truth": (205, 180, 130),
    "counterfactual": (230, 110, 40),
    "long": (86, 180, 233),
    "observed": (0, 170, 120),
    "readout": (86, 180, 233),
    "rollout": (230, 110, 40),
    "changed": (204, 121, 167),
    "model": (86, 180, 233),
    "own": (0, 170, 120),
    "held": (150, 150, 150),
    "twin": (230, 110, 40),
}
PHASE_COLOURS: tuple[Colour, ...] = ((0, 120, 90), (180, 90, 20), (90, 90, 90))
VEIL = 160  # of 255, how much of a picture the veil of attention covers
MAX_FRAMES = 400  # longer clips are thinned evenly; tracks keep every instant


class Tape:
    """A recording in memory that knows the timelines and how each kind of array is stored."""

    def __init__(
        self,
        meta: Mapping[str, str],
        step: float,
        names: Mapping[str, str],
        shown: Mapping[str, str],
    ) -> None:
        """``names`` of roles, and ``shown`` entities in words, to which *About* leads."""
        import rerun as rr

        self.names = names  # of roles, in the words of their laws
        self.step = step  # seconds between neighbouring values of the `step` timeline
        self.layer = 0.0  # what is stored later is drawn on top
        name = meta.get("cell", "recording")
        # The viewer keeps one layout per application: each cell is its own, so that cells with
        # other entities or bounds can be open together.
        self.stream = rr.RecordingStream(name.replace("/", " "))
        self.stream.set_log_time_enabled(False)
        self.stream.set_log_tick_enabled(False)
        self.stream.send_recording_name(name)
        lines = [f"- **{key}**: {value}" for key, value in meta.items()]
        links = [f"[{text}](recording://{entity})" for entity, text in shown.items()]
        text = "\n".join([f"# {name}", "", *lines, "", " · ".join(links)])
        about = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self.stream.log("about", about, static=True)

    def turn_upright(self, entity: str) -> None:
        """Let y point upwards below ``entity``."""
        import rerun as rr

        self.stream.log(entity, rr.Transform3D(mat3x3=np.diag([1.0, -1.0, 1.0])), static=True)

    def bodies(
        self,
        entity: str,
        times: np.ndarray,
        positions: np.ndarray,
        colours: Sequence[Colour],
        radius: float,
    ) -> None:
        """Points ``(T, N, 2)``, and the path from each instant to the next as ``entity/trail``."""
        import rerun as rr

        positions = np.asarray(positions, np.float32)
        bodies = positions.shape[1]
        tint = [colours[n % len(colours)] for n in range(bodies)]
        self.layer += 0.1
        point = rr.Points2D.from_fields(colors=tint, radii=[radius], draw_order=30 + self.layer)
        self.stream.log(entity, point, static=True)
        seen = np.isfinite(positions).all((1, 2))
        columns = rr.Points2D.columns(positions=positions[seen].reshape(-1, 2))
        # An instant without bodies clears them: latest-at would keep showing the last ones.
        self.stream.send_columns(entity, self._when(times), columns.partition(seen * bodies))
        strip = rr.LineStrips2D.from_fields(
            colors=tint, radii=[0.25 * radius], draw_order=20 + self.layer
        )
        self.stream.log(f"{entity}/trail", strip, static=True)
        both = seen[1:] & seen[:-1]
        pieces = np.stack([positions[:-1], positions[1:]], axis=2)[both]
        trail = rr.LineStrips2D.columns(strips=pieces.reshape(-1, 2, 2))
        lengths = np.full(both.sum(), bodies)
        when = self._when(np.asarray(times)[1:][both])
        self.stream.send_columns(f"{entity}/trail", when, trail.partition(lengths))

    def energy(self, role: str, times: np.ndarray, values: np.ndarray) -> None:
        """An energy and, where it is defined, log10 of its relative error since t = 0."""
        self.series(f"energy/{role}", times, values, role)
        rolled = np.asarray(times) >= 0
        since, values = np.asarray(times)[rolled], np.asarray(values, np.float64)[rolled]
        if not len(values) or not np.isfinite(values[0]) or values[0] == 0:
            return
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.log10(np.abs(values - values[0]) / abs(values[0]))
        self.series(f"energy_error/{role}", since, error, role)

    def series(self, entity: str, times: np.ndarray, values: np.ndarray, role: str) -> None:
        """Scalars ``(T,)`` or ``(T, N)`` as lines in the role's colour."""
        self.line(entity, times, values, self.names.get(role, role), COLOURS[role])

    def line(
        self, entity: str, times: np.ndarray, values: np.ndarray, name: str, colour: Colour
    ) -> None:
        """Scalars ``(T,)`` or ``(T, N)`` as lines of one colour; several are counted."""
        import rerun as rr

        rows = np.asarray(values, np.float64).reshape(len(times), -1)
        names = [name] if rows.shape[1] == 1 else [f"{name} {n + 1}" for n in range(rows.shape[1])]
        colours = [colour] * rows.shape[1]
        line = rr.SeriesLines(colors=colours, names=names, widths=[2.0] * rows.shape[1])
        self.stream.log(entity, line, static=True)
        seen = np.isfinite(rows).all(1)
        columns = rr.Scalars.columns(scalars=rows[seen].ravel())
        lengths = np.full(seen.sum(), rows.shape[1])
        when = self._when(np.asarray(times)[seen])
        self.stream.send_columns(entity, when, columns.partition(lengths))

    def pictures(self, entity: str, times: np.ndarray, frames: np.ndarray) -> int:
        """Pictures, thinned and shrunk to the caps; returns the factor they shrank by."""
        import rerun as rr

        factor = picture_factor(times, frames)
        for k in range(0, len(frames), -(-len(frames) // MAX_FRAMES)):
            picture = rr.Image(shrink(frames[k], factor))
            self._at(times[k])
            encode = stored_as_jpeg(times, frames)
            self.stream.log(entity, picture.compress(jpeg_quality=90) if encode else picture)
        self.stream.reset_time()
        return factor

    def attention(
        self, entity: str, times: np.ndarray, shares: np.ndarray, size: tuple[float, float]
    ) -> None:
        """Shares ``(F, N, h, w)`` as a veil over pictures of a size; it ends at the last of times.

        Each body has its colour; what counts most for it is covered most.

        Args:
            entity: its name.
            times: ``(F + 1,)``, seconds.
            shares: of a grid over the picture, for each body.
            size: (height, width) of the pictures as they are stored, pixels.
        """
        import rerun as rr

        rows, columns = shares.shape[2:]
        stretch = np.diag([size[1] / columns, size[0] / rows, 1.0])
        self.stream.log(entity, rr.Transform3D(mat3x3=stretch), static=True)
        colours = np.array([BODY_COLOURS[n % len(BODY_COLOURS)] for n in range(shares.shape[1])])
        for k in range(len(shares)):
            each = shares[k] / shares[k].max((1, 2), keepdims=True)
            tint = np.einsum("nhw,nc->hwc", each, colours) / each.sum(0)[..., None].clip(1e-9)
            veil = np.concatenate([tint, VEIL * each.max(0)[..., None]], -1).astype(np.uint8)
            self._at(times[k])
            self.stream.log(entity, rr.Image(veil, color_model="RGBA", draw_order=-5.0))
        self._at(times[-1])
        self.stream.log(entity, rr.Clear(recursive=False))
        self.stream.reset_time()

    def phases(self, marks: Mapping[float, str]) -> None:
        """What holds from each instant (seconds) on."""
        import rerun as rr

        colours = [PHASE_COLOURS[n % len(PHASE_COLOURS)] for n in range(len(marks))]
        style = rr.StateConfiguration(values=list(marks.values()), colors=colours)
        self.stream.log("phase", style, static=True)
        columns = rr.StateChange.columns(state=list(marks.values()))
        self.stream.send_columns("phase", self._when(np.array(list(marks))), columns)

    def save(self, path: Path, layout: rrb.Blueprint) -> None:
        """Write everything and the layout to ``path``, in one move.

        Not by rerun's own writer, which waits for ever where the disk is full.

        Raises:
            OSError: it cannot be written.
        """
        import rerun as rr

        written = rr.binary_stream(self.stream)
        self.stream.send_blueprint(layout)
        data = written.read()
        self.stream.disconnect()
        with whole(path) as part:
            part.write_bytes(data or b"")

    def _at(self, time: float) -> None:
        """What is logged next is of this instant, seconds."""
        self.stream.set_time("sim_time", duration=float(time))
        self.stream.set_time("step", sequence=round(float(time) / self.step))

    def _when(self, times: np.ndarray) -> list[rr.TimeColumn]:
        import rerun as rr

        steps = np.rint(np.asarray(times) / self.step).astype(np.int64)
        return [
            rr.TimeColumn("sim_time", duration=np.asarray(times, np.float64)),
            rr.TimeColumn("step", sequence=steps),
        ]
