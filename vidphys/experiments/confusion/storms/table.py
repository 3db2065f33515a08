"""The harder confusion scenes: drawn numbers, what trackers do wrong, classes off the menu."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

from vidphys.diagnose.diagnosis import diagnose_motion
from vidphys.diagnose.recordings.motion import Motion, Unseen
from vidphys.experiments.confusion.questions import add_share, recorder
from vidphys.experiments.confusion.scenes import CLIPS, FRAMES
from vidphys.experiments.confusion.scores import Answer, has_pysindy
from vidphys.experiments.confusion.storms.baselines import full_menu, weak_sindy
from vidphys.experiments.confusion.storms.measured import MEASURES, STORMS
from vidphys.experiments.confusion.storms.scenes import LISTED, Class, filmed
from vidphys.experiments.confusion.storms.scores import Scored, ours, scores
from vidphys.experiments.confusion.storms.unlisted import UNLISTED
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.summary import Summary

OURS, SINDY = "diagnose", "weak-sindy"
PER_MEASURE = 16  # held-out episodes of the preset for one way of measuring of each class
NOTHING = Answer(frozenset(), sure=False)


def measures_of(number: int, held_out: int, seed: int) -> list[str]:
    """Ways of measuring in which a class is seen; a small preset takes turns, over the classes."""
    names = list(MEASURES)
    count = min(len(names), max(1, held_out // PER_MEASURE))
    if count > len(names) // 2:
        count = len(names)
    return [names[(number + seed + k * len(names) // count) % len(names)] for k in range(count)]


def run_listed(task: CellTask) -> None:
    """Every class of which the diagnosis was tuned on some seeds."""
    _run(task, LISTED)


def run_unlisted(task: CellTask) -> None:
    """Classes that nobody tunes on, each of which the menu lacks."""
    _run(task, UNLISTED)


def _run(task: CellTask, classes: Mapping[str, Class]) -> None:
    for seed in task.seeds:
        asked = [
            (some, measure)
            for number, some in enumerate(classes.values())
            for measure in measures_of(number, task.sizes.held_out, seed)
        ]
        found: dict[tuple[str, str], list[Scored]] = {}
        for done, (some, measure) in enumerate(asked, 1):
            for method, answer in answers(filmed(some, measure, seed).motion).items():
                scored = Scored(some.name, some.truth, answer)
                for group in (*groups_of(measure), f"class/{some.name}"):
                    found.setdefault((group, method), []).append(scored)
            if task.progress is not None:
                task.progress(done, len(asked), 0.0)
        for group, method in found:
            _record(task, seed, group, method, found[group, method])
        for group in {group for group, _ in found} if not has_pysindy() else ():
            rows = recorder(task, seed, f"{group}/{SINDY}", SINDY)
            # pip install vidphys[bench] brings it
            rows.add("exact_structure", Summary(None, "skipped", 0, 0))


def groups_of(measure: str) -> list[str]:
    """The parts of the records that a scene so measured counts in."""
    return [measure, "storm"] if measure in STORMS else [measure]


def answers(motion: Motion) -> dict[str, Answer]:
    """What each method says of a recording; one that cannot read it tells nothing."""
    said = {OURS: ours(diagnose_motion(motion))}
    rivals = {"full-menu": full_menu} | ({SINDY: weak_sindy} if has_pysindy() else {})
    for name, rival in rivals.items():
        try:
            said[name] = rival(motion)
        except Unseen:
            said[name] = NOTHING
    return said


def _record(task: CellTask, seed: int, group: str, method: str, scored: Sequence[Scored]) -> None:
    rows = recorder(task, seed, group if method == OURS else f"{group}/{method}", method)
    for metric, holds in scores(scored).items():
        if holds:
            add_share(rows, metric, holds)


DIAGNOSE_STORMS = Table.told(
    "diagnose-storms",
    cells={"listed": run_listed, "unlisted": run_unlisted},
    settings={
        "clips": CLIPS,
        "frames": FRAMES,
        "measures": list(MEASURES),
        "classes": {
            name: sorted(some.truth) if some.truth is not None else "outside the menu"
            for name, some in {**LISTED, **UNLISTED}.items()
        },
        "scenes": len(list(product(LISTED, MEASURES))),
    },
)
