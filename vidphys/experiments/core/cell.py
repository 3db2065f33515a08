"""What a table of the study is: named cells, each of which leaves records for every seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from vidphys.experiments.core.figures import Sweep
from vidphys.presets import PRESETS, OracleSizes, PixelSizes
from vidphys.progress import Progress
from vidphys.runs.records import Origin, Recorder
from vidphys.scenes import Scene


@dataclass(frozen=True)
class CellTask:
    """One cell's work for all its seeds.

    Args:
        table, cell: names.
        seeds: which; they train side by side.
        sizes: of the preset, for training on true states.
        pixel: of the preset, for pictures; the quick one's where not given.
        device: where to train and roll.
        folder: for checkpoints, or ``None``.
        progress: called as ``(step, steps, loss)``.
        recorders: filled by :meth:`recorder`.
    """

    table: str
    cell: str
    seeds: tuple[int, ...]
    sizes: OracleSizes
    pixel: PixelSizes = PRESETS["quick"].pixel
    device: str = "cpu"
    folder: Path | None = None
    progress: Progress | None = None
    recorders: list[Recorder] = field(default_factory=list)

    def recorder(
        self,
        seed: int,
        scene: Scene,
        head: str,
        part: str | None = None,
        grounding: str = "oracle",
        encoder: str = "none",
        binder: str = "none",
    ) -> Recorder:
        """A recorder of this cell, or of a named part of it, for one seed.

        Args:
            seed: of the run.
            scene: gives the system's name.
            head: name of the model.
            part: makes the cell ``cell/part``, for cells that compare several settings.
            grounding, encoder, binder: what the states were perceived by.
        """
        origin = Origin(
            experiment=self.table,
            cell=self.cell if part is None else f"{self.cell}/{part}",
            system=scene.name,
            grounding=grounding,
            encoder=encoder,
            binder=binder,
            readout="none",
            head=head,
            seed=seed,
            device=self.device,
            dtype="float32",
        )
        self.recorders.append(Recorder(origin))
        return self.recorders[-1]

    def checkpoint(self, stage: str) -> Path | None:
        return None if self.folder is None else self.folder / f"{stage}.json"


Cell = Callable[[CellTask], None]


@dataclass(frozen=True)
class Table:
    """One table or figure of the study.

    Args:
        name: as on the command line, and of its file in ``bars/``.
        title: of its section in the report.
        about: one or two sentences: what is asked, and of which models.
        ids: of the study's results that it regenerates.
        cells: name -> the work; none where another table's records are read.
        settings: scenes and terms, for ``run.json``.
        source: the table whose records are read, where it is not this one.
        pixels: whether its cells draw and see pictures; `all` leaves such tables out.
        sweeps: its figures, beside those that every table has.
    """

    name: str
    title: str
    about: str
    ids: str
    cells: Mapping[str, Cell] = field(default_factory=dict)
    settings: Mapping[str, object] = field(default_factory=dict)
    source: str = ""
    pixels: bool = False
    sweeps: tuple[Sweep, ...] = ()

    @property
    def records_of(self) -> str:
        """Name of the table whose records its rows are read from."""
        return self.source or self.name
