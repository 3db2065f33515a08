"""Formulas off the menu: exact, refused or wrong, on laws by hand and on laws that a seed draws."""

from __future__ import annotations

import numpy as np
import torch

from vidphys import metrics
from vidphys.diagnose.formula.laws import FoundLaw, coordinate_law
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.formulas.laws import FRAMES, NOISE, SWINGS, Case, developed, drawn
from vidphys.experiments.formulas.sparse import sparse_law

HELD_OUT = 30
EXACT, REFUSED, WRONG = "exact", "refused", "wrong"


def judged(case: Case, found: FoundLaw) -> str:
    """Whether a law was found as it is, not at all, or as another.

    Words of x and of |x| are one where the places stay above zero. The friction must be the law's
    own, or be told as one of those that it may be.
    """
    formula = found.verdict.formula
    if formula is None:
        return REFUSED
    rubbed = ("v" if case.friction else "") in found.frictions
    return EXACT if rubbed and _same(case, formula.kind) else WRONG


def judged_sparse(case: Case, kind: tuple[str, ...], rubbed: bool) -> str:
    """The same of a sparse regression, which never refuses."""
    return EXACT if rubbed == (case.friction > 0) and _same(case, kind) else WRONG


def _same(case: Case, kind: tuple[str, ...]) -> bool:
    """Whether a law's words are these."""
    if case.kind is None:
        return False
    positive = bool(np.nanmin(case.recording(0)[0]) > 0)
    return _plain(kind, positive) == _plain(case.kind, positive)


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
    """Laws that the seed draws, to tune on."""
    for seed in task.seeds:
        _run(task, seed, drawn(10_000 + seed, HELD_OUT))


def run_held_out(task: CellTask) -> None:
    """Laws that the seed draws, on which nothing was tuned."""
    for seed in task.seeds:
        _run(task, seed, drawn(20_000 + seed, HELD_OUT))


def _run(task: CellTask, seed: int, cases: list[Case]) -> None:
    answers, sparse = [], []
    for number, case in enumerate(cases):
        recording = case.recording(seed + number)
        answers.append(judged(case, coordinate_law(*recording)))
        sparse.append(judged_sparse(case, *sparse_law(*recording)))
        if task.progress is not None:
            task.progress(number + 1, len(cases), 0.0)
    _keep(task, seed, "formula", answers)
    _keep(task, seed, "sparse", sparse)


def _keep(task: CellTask, seed: int, head: str, answers: list[str]) -> None:
    rows = task.recorder(seed, "formulas", head, head, "tracks", dtype="float64")
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
    cells={"developed": run_developed, "drawn": run_drawn, "held_out": run_held_out},
    settings={"frames": FRAMES, "noise": NOISE, "swings": SWINGS, "held_out": HELD_OUT},
)
