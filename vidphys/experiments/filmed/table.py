"""The filmed clips as a table: followed, rightly explained, in their intervals, foretold?"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import torch

from vidphys import metrics
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.filmed.folder import film_clip
from vidphys.experiments.filmed.nuisances import PARTS
from vidphys.experiments.filmed.scenes.kinds import KINDS, STRUCTURES
from vidphys.experiments.filmed.scores import Score, score_clip
from vidphys.runs.records import Recorder

FEW, ALL = 12, 200  # clips of the quick preset, and of the others, over all seeds
SMALL = 32  # held-out episodes of the quick preset


def run_clips(task: CellTask) -> None:
    """Film each seed's clips, ask the product about each, and hold the answers to the truth."""
    total = FEW if task.sizes.held_out <= SMALL else ALL
    each = -(-total // len(task.seeds))
    with tempfile.TemporaryDirectory() as other:
        folder = Path(other) if task.folder is None else task.folder
        for place, seed in enumerate(task.seeds):
            scores = []
            for number in range(each):
                scores.append(score_clip(film_clip(folder / f"seed{seed}", seed, number)))
                if task.progress is not None:
                    task.progress(place * each + number + 1, each * len(task.seeds), 0.0)
            _record(task, seed, scores)


def _record(task: CellTask, seed: int, scores: Sequence[Score]) -> None:
    groups = {"": scores}
    groups |= {part: [s for s in scores if s.part == part] for part in PARTS}
    groups |= {kind.replace(" ", "-"): [s for s in scores if s.kind == kind] for kind in KINDS}
    for name, some in groups.items():
        if some:
            rows = task.recorder(
                seed, "filmed", "diagnose", name or None, grounding="clips", dtype="float64"
            )
            _shares(rows, some)
            _sizes(rows, some)


def _shares(rows: Recorder, scores: Sequence[Score]) -> None:
    """Shares of clips and numbers.

    ``stays`` is the share of forecasts that are that the bodies stay where they were followed
    last, as no law foretells more; such a one is ``no_worse_than_staying``, and beats nothing.
    """
    numbers = [number for score in scores for number in score.numbers]
    told = [s for s in scores if {"model", "persistence"} <= s.forecast.keys()]
    foretold = [s.forecast for s in told]
    shares = {
        "followed": [s.followed for s in scores],
        "exact_structure": [s.exact for s in scores],
        "exact_and_claimed": [s.exact and s.claimed for s in scores],
        "claimed": [s.claimed for s in scores],
        "sure_and_wrong": [s.wrong_and_sure for s in scores],
        "claimed_and_wrong": [s.claimed and not s.exact for s in scores],
        "numbers_told": [number.value is not None for number in numbers],
        "numbers_inside": [n.inside for n in numbers if n.inside is not None],
        "foretold": [bool(s.forecast) for s in scores],
        "stays": [s.stays for s in told],
        "beats_persistence": [f["model"] < f["persistence"] for f in foretold],
        "no_worse_than_staying": [f["model"] <= f["staying"] for f in foretold if "staying" in f],
    }
    for metric, holds in shares.items():
        if holds:
            values = torch.tensor(holds, dtype=torch.float64)
            rows.add(metric, metrics.mean(values))
            rows.add_episodes(metric, values)


def _sizes(rows: Recorder, scores: Sequence[Score]) -> None:
    """Medians, and the errors with their signs of numbers in clips that are explained.

    ``bias`` is the size of their median, ``bias_mean`` their mean over ``bias_numbers`` of them.
    Beside them stands ``bias_refused``: numbers of which the product says that the clip does not
    tell them, as their interval reaches beyond 30 % of them. They are no answers, and have no part
    in the others.
    """
    claimed = [number for s in scores if s.claimed for number in s.numbers]
    errors = [number.error for s in scores for number in s.numbers if number.error is not None]
    biases = [number.error for number in claimed if number.error is not None]
    hand = [s.forecast for s in scores if {"model", "by hand"} <= s.forecast.keys()]
    sizes: dict[str, Iterable[float]] = {
        "miss": [m for s in scores for m in s.misses if m is not None],
        "number_error": [abs(error) for error in errors],
        "forecast_ratio": [f["model"] / max(f["by hand"], 1e-9) for f in hand],
        "forecast_by_hand": [f["by hand"] for f in hand],
        "seconds": [s.seconds for s in scores],
    }
    for metric, values in sizes.items():
        _median(rows, metric, values)
    if biases:
        rows.add_value("bias", abs(float(np.median(biases))))
        rows.add_value("bias_mean", float(np.mean(biases)))
        rows.add_value("bias_numbers", float(len(biases)))
    if claimed:
        rows.add_value("bias_refused", float(sum(number.refused for number in claimed)))
    for name in {number.name for number in claimed}:
        own = [n.error for n in claimed if n.name == name and n.error is not None]
        _median(rows, f"{name}_error", [abs(error) for error in own])


def _median(rows: Recorder, metric: str, values: Iterable[float]) -> None:
    column = torch.tensor([float(v) for v in values], dtype=torch.float64)
    if len(column):
        rows.add(f"{metric}_median", metrics.median(column))
        rows.add_episodes(metric, column)


FILMED = Table.told(
    "filmed",
    cells={"clips": run_clips},
    settings={
        "clips": [FEW, ALL],
        "parts": list(PARTS),
        "structures": {kind: sorted(terms) for kind, terms in STRUCTURES.items()},
    },
    pixels=True,
    apart=True,
)
