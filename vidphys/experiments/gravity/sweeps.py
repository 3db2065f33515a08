"""What the claims depend on: capacity, data, and the generator."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from dynamics import HEADS, Head
from dynamics.terms import HeadTerm
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_drift, score_inversion
from vidphys.experiments.core.trained import Training, asked_cell
from vidphys.presets import OracleSizes
from vidphys.runs.records import Recorder
from vidphys.scenes import gravity

MODELS = ("factored", "symplectic", "unstructured")
WIDTHS = (32, 128, 512)
TRAJECTORIES = (32, 128, 512)
ACTIVATIONS = ("tanh", "softplus")
GENERATORS = ("gaussian", "ring")
SHARE = 2  # a sweep's cells get the preset's optimiser steps over this


def sweep_cell(
    name: str, term: HeadTerm, generator: str = "gaussian", trajectories: int | None = None
) -> Cell:
    """A cell that trains one model under one setting of the sweep."""

    def sizes(preset: OracleSizes) -> OracleSizes:
        count = preset.trajectories if trajectories is None else trajectories
        return replace(preset, trajectories=count, steps=max(1, preset.steps // SHARE))

    return asked_cell(name, term, partial(gravity, generator), _ask, Training(sizes))


def _ask(task: CellTask, head: Head, recorder: Recorder, question: Question) -> None:
    score_inversion(recorder, head, question)
    score_drift(recorder, head, question)
    score_retrace(recorder, head, question)


def _map_cells() -> dict[str, Cell]:
    cells = {}
    for generator in GENERATORS:
        for activation in ACTIVATIONS:
            for count in (128, None):
                for name in ("factored", "symplectic"):
                    term = HEADS[name].throughout(activation=activation)
                    size = "all" if count is None else str(count)
                    key = f"{name}/{generator}/{activation}/{size}"
                    cells[key] = sweep_cell(name, term, generator, count)
    return cells


CAPACITY = Table.told(
    "capacity",
    cells={
        f"{name}/{width}": sweep_cell(name, HEADS[name].throughout(width=width))
        for name in MODELS
        for width in WIDTHS
    },
)
DATA = Table.told(
    "data",
    cells={
        f"{name}/{count}": sweep_cell(name, HEADS[name], trajectories=count)
        for name in MODELS
        for count in TRAJECTORIES
    },
)
SENSITIVITY = Table.told("sensitivity", cells=_map_cells())
