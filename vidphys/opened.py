"""A run folder as an object: what was asked, what was found, and the models that were left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import pyarrow as pa
from torch import Tensor

from dynamics import Head, build
from dynamics.terms import from_config
from encoders.tensors import read_tensors
from vidphys.errors import InputError
from vidphys.reading import pipeline
from vidphys.runs import checkpoint
from vidphys.runs.folder import RunFolder
from vidphys.runs.recordings import recordings_of
from vidphys.runs.records import read_table
from vidphys.shooting.step import HEAD_DT

SHOWN = 720  # pixels of a notebook
SHOOTING = "shooting"  # of the two readouts of a ladder's cell, the better one
FITTED = "tracks/specified"
TRUE_STATES = "oracle"  # the grounding whose heads step by the scene's own step


@dataclass(frozen=True)
class Run:
    """What lies in the folder of a run; nothing is written.

    Tables are Arrow's: ``polars.from_arrow(run.records)`` and duckdb read them where they lie,
    ``run.records.to_pandas()`` copies.

    Example:
        >>> import tempfile, duckdb
        >>> from vidphys.runs.records import Origin, Recorder
        >>> where = Path(tempfile.mkdtemp()) / "run"
        >>> folder = RunFolder.open(where, {"cells": ["oracle/factored"], "seeds": [0]})
        >>> none = dict.fromkeys(("encoder", "binder", "readout"), "none")
        >>> origin = Origin("ladder", "oracle/factored", "gravity", "oracle", head="factored",
        ...                 seed=0, device="cpu", dtype="float32", **none)
        >>> recorder = Recorder(origin)
        >>> recorder.add_value("inversion_nmse", 0.067)
        >>> folder.finish("oracle-factored-s0", *recorder.tables())
        >>> table = folder.join()

        >>> run = open_run(where)
        >>> run.settings["cells"], run.records.num_rows, run.skipped
        (['oracle/factored'], 1, {})
        >>> records = run.records
        >>> duckdb.sql("select cell, value from records where metric = 'inversion_nmse'").fetchall()
        [('oracle/factored', 0.067)]
    """

    path: Path

    @property
    def manifest(self) -> dict[str, Any]:
        """All of ``run.json``: settings, versions, commit, and what was skipped."""
        return RunFolder(self.path).manifest()

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved configuration of the run."""
        return self.manifest["settings"]

    @property
    def skipped(self) -> dict[str, str]:
        """Why each cell that was not run was not."""
        return {entry["cell"]: entry["reason"] for entry in self.manifest["skipped"]}

    @property
    def records(self) -> pa.Table:
        """One row for each number; see :data:`vidphys.runs.records.RECORD_SCHEMA`.

        Raises:
            InputError: nothing is finished yet.
        """
        return self._table("records")

    @property
    def episodes(self) -> pa.Table:
        """The numbers of single episodes; see :data:`vidphys.runs.records.EPISODE_SCHEMA`.

        Raises:
            InputError: nothing is finished yet.
        """
        return self._table("episodes")

    @property
    def parts(self) -> dict[str, Path]:
        """The file of everything that holds tensors, by the name that :meth:`tensors` takes."""
        kept, shown = self.path / "checkpoints", self.path / "showcase"
        checkpoints = {str(p.relative_to(kept).with_suffix("")): p for p in kept.rglob("*.json")}
        showcases = {f"showcase/{p.stem}": p for p in shown.glob("*.safetensors")}
        return dict(sorted((checkpoints | showcases).items()))

    @property
    def recordings(self) -> dict[str, Path]:
        """Files to look at, by cell: ``.rrd``, or the showcase that one is drawn from."""
        return recordings_of(self.path)

    def tensors(self, part: str) -> dict[str, Tensor]:
        """The tensors of one part, by name.

        Args:
            part: one of :attr:`parts`, such as ``oracle-factored-s0/head``.

        Raises:
            InputError: no such part, or a damaged one.
        """
        file = self._one(part, self.parts, "part")
        return read_tensors(file) if file.suffix == ".safetensors" else checkpoint.load(file)[0]

    def head(self, cell: str, seed: int = 0, readout: str | None = None) -> Head:
        """A trained head, ready to roll.

        Args:
            cell: of a ladder, such as ``oracle/factored``; of ``vidphys train``, the name of one
                of the pipeline's heads; of ``vidphys fit``, ``tracks/specified``, whose head counts
                in its own units of length and time.
            seed: of the training.
            readout: by which a ladder's head of seen clips was trained; ``shooting`` by default.

        Raises:
            InputError: the run has no such head, or a damaged one.
        """
        if self.has_pipeline:
            return self._one(cell, self.pipeline().dynamics.heads, "head")
        if cell == FITTED and "heads/specified" in self.parts:
            return _head(self.parts["heads/specified"], HEAD_DT)
        start = f"{cell.replace('/', '-')}-s{seed}/"
        heads = {part: file for part, file in self.parts.items() if part.endswith("/head")}
        of_cell = {part[len(start) :]: f for part, f in heads.items() if part.startswith(start)}
        if not of_cell:
            self._one(f"{start}head", heads, "head")
        name = "head" if "head" in of_cell and readout is None else f"{readout or SHOOTING}/head"
        before = {"dt_seconds": HEAD_DT}  # the step of heads that were kept without theirs
        if cell.startswith(f"{TRUE_STATES}/"):
            before = self.settings.get("scene", before)
        return _head(self._one(name, of_cell, f"head of {cell}"), before["dt_seconds"])

    @property
    def has_pipeline(self) -> bool:
        """Whether the run is a finished ``vidphys train``."""
        return (self.path / "checkpoints" / pipeline.FILE).is_file()

    def pipeline(self, weights: Path | None = None, device: str = "cpu") -> pipeline.Pipeline:
        """What a training made: frames in, tracks and rollout out.

        Args:
            weights, device: see :func:`vidphys.reading.pipeline.load_pipeline`.

        Raises:
            InputError: the run is no finished training, or its encoder has changed.
            ValueError: the encoder's weights are missing or wrong.
        """
        return pipeline.load_pipeline(self.path, weights, device)

    def _repr_html_(self) -> str:
        """What a notebook shows: the run's report, its settings where there is none yet."""
        report = self.path / "report.html"
        if report.is_file():
            page = escape(report.read_text(encoding="utf-8"))
            style = f"width: 100%; height: {SHOWN}px; border: 0"
            return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{page}"></iframe>'
        rows = (
            f"<tr><th>{escape(str(name))}</th><td>{escape(str(value))}</td></tr>"
            for name, value in self.settings.items()
        )
        name = escape(self.path.name)
        return f"<p>A run without a report yet: {name}</p><table>{''.join(rows)}</table>"

    def _table(self, kind: str) -> pa.Table:
        file = self.path / f"{kind}.parquet"
        if not file.is_file():
            raise InputError(f"run folder {self.path}: nothing is finished, so it has no {kind}")
        return read_table(file)

    def _one(self, name: str, known: Mapping[str, Any], what: str) -> Any:
        if name not in known:
            has = ", ".join(known) or "none"
            raise InputError(f"run folder {self.path}: no {what} '{name}'; there are: {has}")
        return known[name]


def _head(file: Path, dt: float) -> Head:
    tensors, meta = checkpoint.load(file)
    term = from_config(meta["terms"])
    if "units" in meta:
        term = term.counted_in(meta["units"]["length"], meta["units"]["seconds"])
    step, space = meta.get("dt") or dt, meta.get("space", 2)
    head = build(term, meta["bodies"], step, space, meta.get("conditions"))
    head.load_state_dict(tensors)
    return head.eval()


def open_run(path: Path | str) -> Run:
    """The run that lies in a folder.

    Raises:
        InputError: there is none.
    """
    return Run(RunFolder.existing(Path(path)).path)
