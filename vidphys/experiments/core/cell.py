"""What a table of the study is: named cells, each of which leaves records for every seed."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar, runtime_checkable

from vidphys.devices import device_name
from vidphys.experiments.core.figures import Panel, Sweep
from vidphys.perception.base import Grounding
from vidphys.presets import PRESETS, OracleSizes, PixelSizes
from vidphys.progress import Progress
from vidphys.runs.records import Origin, Recorder
from vidphys.scenes import Scene

T = TypeVar("T")
TEXT = Path(__file__).parents[1].joinpath("tables.toml").read_text(encoding="utf-8")
WORDS: Mapping[str, Any] = tomllib.loads(TEXT)
Report = Callable[[str, int, int], None]  # of a stage's name, step and steps


class Kept:
    """The last thing of each kind that a worker made, for the next cell that asks for the same."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[Hashable, Any]] = {}

    def once(self, kind: str, key: Hashable, make: Callable[[], T]) -> T:
        """What ``make`` gives; the last of its kind again, where that was made under this key."""
        if kind not in self._last or self._last[kind][0] != key:
            self._last[kind] = key, make()
        return self._last[kind][1]


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
        report: called as ``(stage, step, steps)``; a stage may have no name.
        showcase: file for the arrays of a recording, or ``None``.
        shown: the seed whose arrays are kept there.
        kept: what cells that one worker does in one go share.
        recorders: filled by :meth:`recorder`.
    """

    table: str
    cell: str
    seeds: tuple[int, ...]
    sizes: OracleSizes
    pixel: PixelSizes = PRESETS["quick"].pixel
    device: str = "cpu"
    folder: Path | None = None
    report: Report | None = None
    showcase: Path | None = None
    shown: int = 0
    kept: Kept = field(default_factory=Kept)
    recorders: list[Recorder] = field(default_factory=list)

    def recorder(
        self,
        seed: int,
        scene: Scene | str,
        head: str,
        part: str | None = None,
        grounding: str = "oracle",
        encoder: str = "none",
        binder: str = "none",
        dtype: str = "float32",
        **seen: Any,
    ) -> Recorder:
        """A recorder of this cell, or of a named part of it, for one seed.

        Args:
            seed: of the run.
            scene: the system, or its name.
            head: name of the model.
            part: makes the cell ``cell/part``, for cells that compare several settings.
            grounding, encoder, binder: what the states were perceived by.
            dtype: of the model.
            seen: how, see :class:`Origin`.
        """
        origin = Origin(
            experiment=self.table,
            cell=self.cell if part is None else f"{self.cell}/{part}",
            system=scene if isinstance(scene, str) else scene.name,
            grounding=grounding,
            encoder=encoder,
            binder=binder,
            readout="none",
            head=head,
            seed=seed,
            device=device_name(self.device),
            dtype=dtype,
            **seen,
        )
        self.recorders.append(Recorder(origin))
        return self.recorders[-1]

    def checkpoint(self, stage: str) -> Path | None:
        return None if self.folder is None else self.folder / f"{stage}.json"

    @property
    def progress(self) -> Progress | None:
        """Called as ``(step, steps, loss)``."""
        return self.stage("")

    def stage(self, name: str) -> Progress | None:
        """The progress of one stage of the work."""
        report = self.report
        return None if report is None else lambda step, steps, _loss: report(name, step, steps)


Cell = Callable[[CellTask], None]


@runtime_checkable
class OfRung(Protocol):
    """A cell that says by what states are perceived."""

    @property
    def grounding(self) -> Grounding: ...


@dataclass(frozen=True)
class Unit:
    """What one worker does in one go.

    Args:
        table: name by which the catalogue gives it.
        cells: done one after the other.
        seeds: of each cell.
        parts: the name under which each cell's work is kept; other seeds have other names.
    """

    table: str
    cells: tuple[str, ...]
    seeds: tuple[int, ...]
    parts: tuple[str, ...]


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
        apart: whether nothing but its own name chooses it.
        sweeps: its figures, beside those that every table has.
        module: that puts its cells together; a number of theirs is stale when it has changed.
    """

    name: str
    title: str
    about: str
    ids: str
    cells: Mapping[str, Cell] = field(default_factory=dict)
    settings: Mapping[str, object] = field(default_factory=dict)
    source: str = ""
    pixels: bool = False
    apart: bool = False
    sweeps: tuple[Sweep, ...] = ()
    module: str = ""

    @classmethod
    def told(cls, name: str, **work: Any) -> Self:
        """A table whose words and figures stand in ``tables.toml``; ``work`` is the rest of it."""
        words = dict(WORDS[name])
        figures = [
            Sweep(**{**figure, "panels": tuple(Panel(**panel) for panel in figure["panels"])})
            for figure in words.pop("sweeps", ())
        ]
        module = sys._getframe(1).f_globals["__name__"]
        return cls(name, sweeps=tuple(figures), module=module, **words, **work)

    @property
    def records_of(self) -> str:
        """Name of the table whose records its rows are read from."""
        return self.source or self.name

    def units(self, cells: Sequence[str], seeds: tuple[int, ...]) -> list[Unit]:
        """How cells are shared among workers: one each, with all its seeds."""
        numbers = "-".join(map(str, seeds))
        parts = {cell: f"{self.name}.{cell.replace('/', '-')}.s{numbers}" for cell in cells}
        return [Unit(self.name, (cell,), seeds, (part,)) for cell, part in parts.items()]
