"""The whole matrix: which cells a preset has, run family by family and recorded by axis."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from vidphys.errors import InputError
from vidphys.runs.cost import Cost, peak_memory
from vidphys.runs.folder import RunFolder
from vidphys.runs.needs import Needs
from vidphys.runs.records import Origin, Recorder
from vidphys.runs.sealed import read_sealed, write_sealed
from vidphys.runs.units import WorkUnit
from vidphys.stress import (
    balance,
    baths,
    compiled,
    contacts,
    crowds,
    foreign,
    inputs,
    learned,
    long,
    methods,
    orbits,
    pictures,
    threads,
    walls,
)
from vidphys.stress.case import SILENT, SKIPPED, Case
from vidphys.stress.figures import figure_rows
from vidphys.stress.verdict import Outcome, judge
from vidphys.summary import FAILED, OK, Summary

SCHEMA_VERSION = 1
VERDICTS = 2  # schema of verdicts.json; 1 had no seal


@dataclass(frozen=True)
class StressSizes:
    """What a preset runs.

    Args:
        every: of each family, each so many-th cell.
        long_steps: steps of the long rollouts; 0 leaves them out.
        largest: value on the axes of bodies and image sizes above which cells are left out.
    """

    every: int
    long_steps: int
    largest: float


PRESETS = {
    "quick": StressSizes(every=7, long_steps=0, largest=1000),
    "standard": StressSizes(every=1, long_steps=1_000_000, largest=math.inf),
}
HEAVY = ("bodies", "image size")


def families(sizes: StressSizes) -> dict[str, list[Case]]:
    """The cells of a preset, by the family that they are run and kept in."""
    made = {name: list(cases()) for name, cases in _makers(sizes).items()}
    return {name: _thinned(cases, sizes) for name, cases in made.items() if cases}


def _makers(sizes: StressSizes) -> dict[str, Callable[[], Iterable[Case]]]:
    long_ones = {"long": partial(long.long_rollouts, sizes.long_steps)} if sizes.long_steps else {}
    return {
        "methods": methods.methods,
        "softening": orbits.softening,
        "mass-ratio": orbits.mass_ratio,
        "scale": orbits.scale,
        "origin": orbits.origin,
        "time-step": orbits.time_step,
        "stiffness": contacts.stiffness,
        "coincidence": contacts.coincidence,
        "wall": walls.walls,
        "friction": baths.friction,
        "temperature": baths.temperature,
        "drive": baths.drive,
        "bodies": crowds.crowds,
        "image-size": pictures.sizes,
        "reading": pictures.readings,
        "training-range": learned.heads,
        "threads": threads.threads,
        "compiled": compiled.compiled,
        "energy-balance": balance.energy_balance,
        "input": inputs.inputs,
        "foreign": foreign.parts,
        **long_ones,
    }


def _thinned(cases: list[Case], sizes: StressSizes) -> list[Case]:
    # A whole family of promises is cheap, and each of its cells is another promise.
    every = 1 if cases[0].axis.startswith(("method", "foreign")) else sizes.every
    kept = [c for c in cases if c.axis not in HEAVY or c.value <= sizes.largest]
    return kept[::every]


def settings_of(preset: str, axes: Sequence[str]) -> dict[str, Any]:
    """The run's resolved configuration.

    Raises:
        InputError: an axis that there is not.
    """
    sizes = PRESETS[preset]
    known = list(families(sizes))
    for name in axes:
        if name not in known:
            raise InputError(f"stress: no axis '{name}' in this preset; use {', '.join(known)}")
    return {
        "experiment": "stress",
        "preset": preset,
        "sizes": {k: v for k, v in asdict(sizes).items() if v != math.inf},
        "cells": list(axes) or known,
        "seeds": [0],
    }


def units_of(names: Sequence[str], preset: str) -> list[WorkUnit]:
    """The families of a run as units of work, in the order of the matrix."""
    most = Needs(cores=max(threads.COUNTS))
    return [
        WorkUnit({name: name}, name, (name, preset), most if name == "threads" else Needs())
        for name in _makers(PRESETS[preset])
        if name in names
    ]


def run_family(path: Path, name: str, preset: str, report: Callable[[str, int, int], None]) -> None:
    """Judge a family's cells, one after the other, and keep what was found.

    Args:
        path: the run folder.
        name: of the family.
        preset: of the run.
        report: called as ``(name, cells done, cells)``.
    """
    run, sizes, outcomes = RunFolder(path), PRESETS[preset], []
    began = time.perf_counter()
    cases = _thinned(list(_makers(sizes)[name]()), sizes)
    for index, case in enumerate(cases):
        outcomes.append(judge(case))
        report(name, index + 1, len(cases))
    kept = {"cells": [_plain(outcome) for outcome in outcomes]}
    write_sealed(_kept(run, name), kept, SCHEMA_VERSION)
    cost = Cost(time.perf_counter() - began, peak_memory())
    run.finish(name, *_recorded(outcomes).tables(), cost=cost)


def _recorded(outcomes: Sequence[Outcome]) -> Recorder:
    """An error and a verdict a cell, each in the precision that it was computed in."""
    whole = Recorder(_origin(outcomes[0].case))
    for outcome in outcomes:
        recorder = whole.beside(_origin(outcome.case))
        missing = "skipped" if outcome.verdict == SKIPPED else FAILED
        status = missing if outcome.error is None else OK
        recorder.add("error", Summary(outcome.error, status, 1, 0), seconds=outcome.seconds)
        recorder.add_value(f"verdict: {outcome.verdict}", 1.0)
        recorder.add_value("silently_wrong", float(outcome.verdict == SILENT))
    return whole


def _origin(case: Case) -> Origin:
    device = "cuda" if case.path == "cuda" else "cpu"
    blank = Origin("stress", case.name, case.system, "", "", "", "", "", 0, device, case.dtype)
    return replace(blank, grounding=case.axis, readout=case.path, head=case.integrator)


def _plain(outcome: Outcome) -> dict[str, Any]:
    case = {k: v for k, v in vars(outcome.case).items() if k not in ("run", "home")}
    case["must"] = list(outcome.case.must)
    return {
        **case,
        "name": outcome.case.name,
        "verdict": outcome.verdict,
        "allowed": outcome.allowed,
        "error": outcome.error,
        "said": outcome.said,
        "seconds": outcome.seconds,
    }


def _kept(run: RunFolder, name: str) -> Path:
    return run.path / "outcomes" / f"{name}.json"


def load_family(run: RunFolder, name: str, cases: list[Case]) -> list[Outcome]:
    """What was found of a family that is done."""
    path, todo = _kept(run, name), "delete it and the part beside it, and run again"
    kept = read_sealed(path, "outcomes", todo, SCHEMA_VERSION, ["cells"])
    found = {cell["name"]: cell for cell in kept["cells"]}
    return [
        Outcome(case, *(found[case.name][k] for k in ("verdict", "error", "said", "seconds")))
        for case in cases
    ]


def write_verdicts(run: RunFolder, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """``verdicts.json``: counts, all cells, and the table of figures."""
    counts = Counter(outcome.verdict for outcome in outcomes)
    verdicts = {
        "counts": dict(counts),
        "seconds": sum(outcome.seconds for outcome in outcomes),
        "cells": [_plain(outcome) for outcome in outcomes],
        "figures": [asdict(row) for row in figure_rows(outcomes)],
    }
    write_sealed(run.path / "verdicts.json", verdicts, VERDICTS)
    return verdicts
