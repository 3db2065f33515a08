"""The grounding ladder: the same question to the same heads, from the oracle down to pixels."""

from __future__ import annotations

import difflib
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from dynamics import HEADS, Head, Rollout, to_config
from vidphys.errors import InputError
from vidphys.experiments.core.members import train_members
from vidphys.experiments.core.oracle import OLDEST, held_out_question, score_oracle, true_examples
from vidphys.experiments.core.scoring import Question, score_lost
from vidphys.experiments.core.showcase import write_showcase
from vidphys.experiments.pixels.seen import (
    TRAINERS,
    draw,
    fit_perception,
    perceive,
    train_and_score,
)
from vidphys.perception.catalogue import GROUNDINGS
from vidphys.presets import Preset
from vidphys.runs import checkpoint
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import Origin, Recorder
from vidphys.scenes import Scene, gravity

EXPERIMENT = "ladder"
ORACLE = "oracle"
ALL_HEADS = (
    "factored",
    "unstructured",
    "factored-radial",
    "factored-learned-kinetic",
    "symplectic",
)
TWINS = ("factored", "unstructured")
FULL = (ORACLE, "renderer")  # rungs on which every head is compared
RUNGS = (ORACLE, *GROUNDINGS)
DTYPE = "float32"
# The study's inversion nMSE at G = -1 (its Tables grounding, f36 and f38), drawn beside ours.
STUDY = {
    "oracle/factored": 0.067,
    "renderer/factored": 0.12,
    "cnn-supervised/factored": 0.06,
    "cnn-discovered/factored": 0.075,
    "jepa/factored": 1.46,
    "jepa/unstructured": 0.99,
    "jepa-centroid/factored": 0.40,
    "jepa-centroid/unstructured": 0.68,
    "jepa-exact/factored": 0.405,
    "rgb-tracked/factored": 0.45,
    "rgb-tracked/unstructured": 0.82,
    "anonymous-hand/factored": 0.76,
    "anonymous-hand/unstructured": 0.76,
    "anonymous-tracker/factored": 0.15,
    "anonymous-tracker/unstructured": 0.64,
    "anonymous-tracker-twostage/factored": 0.16,
    "anonymous-slots/factored": 0.92,
    "anonymous-slots/unstructured": 0.93,
    "composed/factored": 0.73,
}


@dataclass(frozen=True)
class Unit:
    """What one worker does in one go: a rung and a seed, with all the heads asked of it."""

    grounding: str
    heads: tuple[str, ...]
    seed: int

    def part(self, head: str) -> str:
        """Name of one cell's piece of work."""
        return f"{self.grounding}-{head}-s{self.seed}"


@dataclass(frozen=True)
class Plan:
    """The ladder that was asked for."""

    units: tuple[Unit, ...]

    @property
    def parts(self) -> list[str]:
        return [unit.part(head) for unit in self.units for head in unit.heads]


def plan(rungs: Sequence[str], heads: Sequence[str], seeds: int) -> Plan:
    """Cells by name: rungs or ``rung/head``; no name means all.

    Raises:
        InputError: an unknown rung or head (the nearest spelling is given), or no seed.
    """
    if seeds < 1:
        raise InputError(f"--seeds {seeds}: at least one seed is needed")
    for head in heads:
        _known(head, tuple(HEADS), "--heads")
    chosen: dict[str, list[str]] = {}
    for name in rungs or RUNGS:
        rung, _, head = name.partition("/")
        _known(rung, RUNGS, "--cells")
        default = ALL_HEADS if rung in FULL else TWINS
        if head:
            _known(head, tuple(HEADS), "--cells")
        asked = [head] if head else list(heads) or list(default)
        chosen.setdefault(rung, []).extend(h for h in asked if h not in chosen.get(rung, []))
    # Seeds outermost: an interrupted ladder has whole ladders of fewer seeds.
    return Plan(tuple(Unit(r, tuple(h), seed) for seed in range(seeds) for r, h in chosen.items()))


def _known(name: str, names: tuple[str, ...], option: str) -> None:
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        raise InputError(f"{option} {name}: unknown{hint} Known: {', '.join(names)}")


def settings_of(preset_name: str, preset: Preset, ladder: Plan) -> dict[str, Any]:
    """The resolved configuration, as it stands in ``run.json``."""
    return {
        "experiment": EXPERIMENT,
        "preset": preset_name,
        "sizes": asdict(preset),
        "seeds": sorted({unit.seed for unit in ladder.units}),
        "cells": sorted({f"{u.grounding}/{h}" for u in ladder.units for h in u.heads}),
        "scene": oracle_scene().settings,
        "oldest_training_start_steps": OLDEST,
        "pixel_scene": pixel_scene().settings,
        "heads": {name: to_config(term) for name, term in HEADS.items()},
        "device": "cpu",
        "dtype": DTYPE,
        "references": STUDY,
    }


def oracle_scene() -> Scene:
    """S1 with the headline generator."""
    return gravity("gaussian")


def pixel_scene() -> Scene:
    """S1 with unit masses: a disk's picture does not show its mass."""
    return gravity("gaussian", mass=(1.0, 1.0))


Report = Callable[[str, int, int], None]


def run_unit(path: Path, unit: Unit, preset: Preset, report: Report) -> None:
    """Do what is left of one unit and keep each cell's tables as it is finished.

    Args:
        path: the run folder.
        unit: rung, heads and seed.
        preset: sizes.
        report: called as ``(stage, step, steps)``.
    """
    torch.set_num_threads(1)
    run = RunFolder(path)
    left = [head for head in unit.heads if not run.is_done(unit.part(head))]
    if not left:
        return
    if unit.grounding == ORACLE:
        _run_oracle(run, unit, left, preset, report)
    else:
        _run_pixels(run, unit, left, preset, report)


def _run_oracle(
    run: RunFolder, unit: Unit, heads: list[str], preset: Preset, report: Report
) -> None:
    scene = oracle_scene()
    question = held_out_question(scene, preset.oracle.held_out, unit.seed)
    examples = true_examples(scene, preset.oracle.trajectories, [unit.seed])
    for name in heads:
        recorder = Recorder(_origin(unit, name, scene, "none", "none"))
        folder = run.checkpoints(unit.part(name))
        began = time.perf_counter()
        try:
            progress = _stage(report, unit.part(name))
            trained = train_members(
                name,
                partial(scene.build, HEADS[name]),
                examples,
                preset.oracle,
                {unit.seed: recorder},
                save_to=folder / "fit.json",
                progress=progress,
            )
            if unit.seed not in trained:
                raise FloatingPointError(f"{name}: the trained weights are not finite")
            head = trained[unit.seed]
            rolled = score_oracle(recorder, head, question)
            _keep(name, head, question, folder)
            _show(run, unit, name, head, question, rolled)
        except FloatingPointError:
            score_lost(recorder, preset.oracle.held_out)
        recorder.took(time.perf_counter() - began)
        run.finish(unit.part(name), *recorder.tables())


def _run_pixels(
    run: RunFolder, unit: Unit, heads: list[str], preset: Preset, report: Report
) -> None:
    scene, sizes = pixel_scene(), preset.pixel
    grounding = GROUNDINGS[unit.grounding]
    report(f"{unit.grounding} seed {unit.seed}: rendering", 0, 1)
    seen = draw(scene, grounding, sizes, unit.seed)
    perceived = None
    for name in heads:
        part = unit.part(name)
        recorder = Recorder(_origin(unit, name, scene, grounding.encoder, grounding.binder))
        if perceived is None or grounding.joint:
            folder = run.checkpoints(part if grounding.joint else f"{unit.grounding}-s{unit.seed}")
            progress = _stage(report, f"{part}: seeing")
            perception = fit_perception(grounding, seen, sizes, unit.seed, name, folder, progress)
            perceived = perceive(perception, seen)
        shown = None
        for readout in TRAINERS:
            reading = recorder.reading(readout)
            folder = run.checkpoints(part) / readout
            began = time.perf_counter()
            try:
                head, question, rolled = train_and_score(
                    readout,
                    name,
                    scene,
                    seen,
                    perceived,
                    sizes,
                    unit.seed,
                    reading,
                    folder,
                    _stage(report, f"{part}: {readout}"),
                )
                _keep(name, head, question, folder)
                shown = head, question, rolled  # the last readout is the better one
            except FloatingPointError:
                score_lost(reading, sizes.held_out)
            reading.took(time.perf_counter() - began)
        if shown is not None:
            _show(run, unit, name, *shown, seen.test, perceived.test)
        run.finish(part, *recorder.tables())


def _origin(unit: Unit, head: str, scene: Scene, encoder: str, binder: str) -> Origin:
    return Origin(
        experiment=EXPERIMENT,
        cell=f"{unit.grounding}/{head}",
        system=scene.name,
        grounding=unit.grounding,
        encoder=encoder,
        binder=binder,
        readout="none",
        head=head,
        seed=unit.seed,
        device="cpu",
        dtype=DTYPE,
    )


def _stage(report: Report, name: str) -> Callable[[int, int, float], None]:
    return lambda step, steps, _loss: report(name, step, steps)


def _keep(name: str, head: Head, question: Question, folder: Path) -> None:
    """Keep the trained head."""
    meta = {"step": 0, "terms": to_config(HEADS[name]), "bodies": question.scene.bodies}
    checkpoint.save(folder / "head.json", dict(head.state_dict()), meta)


def _show(
    run: RunFolder,
    unit: Unit,
    name: str,
    head: Head,
    question: Question,
    rolled: Rollout,
    *seen: Any,
) -> None:
    """For the first seed, keep the arrays of a cell's recording."""
    if unit.seed == 0:
        cell = f"{unit.grounding}/{name}"
        meta = {"cell": cell, "seed": "0"}
        write_showcase(run.showcase(cell), head, question, rolled, meta, *seen)
