"""Known motions as tables: exact, sure and wrong, errors of the numbers and their intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from vidphys import metrics
from vidphys.diagnose.telling.answered import Answered
from vidphys.diagnose.telling.answers import answer
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.recorded.cases import CASES, Case
from vidphys.runs.records import Recorder
from vidphys.seeding import derive
from vidphys.statistics import NORMAL_95

FEW, ALL = 20, 60  # recordings of a cell, of the quick preset and of the others
SMALL = 32  # held-out episodes of the quick preset
HELD_OUT = 0.3  # of a recording, at its end
EXPLAINED, NOT = "explained", "not explained"


@dataclass(frozen=True)
class Score:
    """What became of a recording.

    Args:
        case: of it.
        kinds, status: of the answer.
        exact: whether precisely the right terms are named, or a formula where there are none.
        errors: relative, of the numbers that are told.
        inside: whether the 95 % interval of each holds the truth.
    """

    case: Case
    kinds: tuple[str, ...]
    status: str
    exact: bool
    errors: dict[str, float]
    inside: dict[str, bool]

    @property
    def claimed(self) -> bool:
        return self.status != NOT


def score(case: Case) -> Score:
    """Ask the product about a recording, and hold the answer to the truth."""
    found = answer(case.motion, False, HELD_OUT)
    kinds = frozenset(found.data["terms"])
    status = str(found.data["status"])
    exact = "formula" in kinds if case.kinds is None else kinds == case.kinds
    told = _told(found)
    errors = {n: told[n][0] / true - 1 for n, true in case.numbers.items() if n in told}
    inside = {
        n: abs(told[n][0] - true) <= NORMAL_95 * told[n][1]
        for n, true in case.numbers.items()
        if n in told
    }
    return Score(case, tuple(sorted(kinds)), status, exact, errors, inside)


def _told(found: Answered) -> dict[str, tuple[float, float]]:
    """Numbers of the first law with their standard errors."""
    groups = found.data.get("mechanism", [])
    quantities = groups[0]["quantities"] if groups else {}
    return {name: (x["value"], x["standard_error"]) for name, x in quantities.items()}


def _cell(name: str) -> Callable[[CellTask], None]:
    def run(task: CellTask) -> None:
        count = FEW if task.sizes.held_out <= SMALL else ALL
        for place, seed in enumerate(task.seeds):
            scores = []
            for number in range(count):
                random = np.random.default_rng(derive(seed, "recorded", name, str(number)))
                scores.append(score(CASES[name](random)))
                if task.progress is not None:
                    done = place * count + number + 1
                    task.progress(done, count * len(task.seeds), 0.0)
            _record(task.recorder(seed, name, "diagnose", dtype="float64"), scores)

    return run


def _record(rows: Recorder, scores: Sequence[Score]) -> None:
    shares = {
        "exact": [x.exact for x in scores],
        "claimed": [x.claimed for x in scores],
        "claimed_and_wrong": [x.claimed and not x.exact for x in scores],
        "sure_and_wrong": [x.status == EXPLAINED and not x.exact for x in scores],
        "inside": [held for x in scores for held in x.inside.values()],
    }
    for metric, holds in shares.items():
        if holds:
            values = torch.tensor(holds, dtype=torch.float64)
            rows.add(metric, metrics.mean(values))
            rows.add_episodes(metric, values)
    for name in scores[0].case.numbers:
        sizes = [abs(x.errors[name]) for x in scores if name in x.errors]
        if sizes:
            values = torch.tensor(sizes, dtype=torch.float64)
            metric = f"{name.replace(' ', '_')}_error"
            rows.add(f"{metric}_median", metrics.median(values))
            rows.add_episodes(metric, values)


RECORDED = Table.told(
    "recorded",
    cells={name: _cell(name) for name in CASES},
    settings={"recordings": [FEW, ALL], "held_out": HELD_OUT},
    apart=True,
)
