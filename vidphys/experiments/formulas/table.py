"""Formulas off the menu: exact, refused or wrong, on laws by hand and on laws that a seed draws."""

from __future__ import annotations

import numpy as np
import torch

from vidphys import metrics
from vidphys.diagnose.formula.laws import FoundLaw, coordinate_law
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.formulas.laws import FRAMES, NOISE, SWINGS, Case, developed, drawn

HELD_OUT = 30
EXACT, REFUSED, WRONG = "exact", "refused", "wrong"


def judged(case: Case, found: FoundLaw) -> str:
    """Whether a law was found as it is, not at all, or as another.

    Words of x and of |x| are one where the places stay above zero.
    """
    formula = found.verdict.formula
    if formula is None:
        return REFUSED
    if case.kind is None:
        return WRONG
    places = case.recording(0)[0]
    positive = bool(np.nanmin(places) > 0)
    same = _plain(formula.kind, positive) == _plain(case.kind, positive)
    return EXACT if same else WRONG


def _plain(kind: tuple[str, ...], positive: bool) -> list[str]:
    if not positive:
        return sorted(kind)
    told = {"x |x|": "x^2", "|x|": "x"}
    return sorted(told.get(name, name.replace("sgn(x) |x|", "x")) for name in kind)


def run_developed(task: CellTask) -> None:
    """The laws by hand."""
    for seed in task.seeds:
        _run(task, seed, developed())


def run_drawn(task: CellTask) -> None:
    """Laws that the seed draws: nothing was tuned on them."""
    for seed in task.seeds:
        _run(task, seed, drawn(10_000 + seed, HELD_OUT))


def _run(task: CellTask, seed: int, cases: list[Case]) -> None:
    answers = []
    for number, case in enumerate(cases):
        answers.append(judged(case, coordinate_law(*case.recording(seed + number))))
        if task.progress is not None:
            task.progress(number + 1, len(cases), 0.0)
    rows = task.recorder(seed, "formulas", "formula", None, "tracks", dtype="float64")
    for metric, good in (
        ("exact", (EXACT,)),
        ("exact_or_refused", (EXACT, REFUSED)),
        ("wrong", (WRONG,)),
    ):
        values = torch.tensor([answer in good for answer in answers], dtype=torch.float64)
        rows.add(metric, metrics.mean(values))
        rows.add_episodes(metric, values)


FORMULAS = Table.told(
    "formulas",
    cells={"developed": run_developed, "drawn": run_drawn},
    settings={"frames": FRAMES, "noise": NOISE, "swings": SWINGS, "held_out": HELD_OUT},
)
