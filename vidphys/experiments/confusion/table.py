"""The confusion scenes: is exactly what a scene requires found, and is the rest left open?"""

from __future__ import annotations

from collections.abc import Sequence

from vidphys.diagnose.diagnosis import diagnose_motion
from vidphys.experiments.confusion.cost import run_cost
from vidphys.experiments.confusion.questions import (
    add_share,
    recorder,
    run_nulls,
    run_power,
    run_switch,
)
from vidphys.experiments.confusion.rates import run_damping, run_energy_balance
from vidphys.experiments.confusion.scenes import CLIPS, FRAMES, KINDS, Kind, Setting, record
from vidphys.experiments.confusion.scores import (
    Marked,
    full_menu,
    hamiltonian,
    has_pysindy,
    ours,
    pysindy,
    scores,
)
from vidphys.experiments.confusion.second_law_questions import run_second_law
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.summary import Summary

# (noise in world units, seconds between frames); a preset takes as many as it has episodes for
SETTINGS = (
    (0.005, 0.04),
    (0.02, 0.08),
    (0.005, 0.08),
    (0.02, 0.04),
    (0.0, 0.04),
    (0.005, 0.01),
    (0.05, 0.08),
    (0.0, 0.08),
    (0.02, 0.01),
    (0.05, 0.04),
    (0.0, 0.01),
    (0.05, 0.01),
)
PER_SETTING = 4  # held-out episodes of the preset for one setting
CLEAR, BLURRED = 0.005, 0.02  # world units
SLOW = 0.04  # seconds
BASELINES = ("full-menu", "hamiltonian", "pysindy")
OURS = "diagnose"


def settings_of(held_out: int) -> tuple[tuple[float, float], ...]:
    """As many settings as the preset's size pays for."""
    return SETTINGS[: max(1, held_out // PER_SETTING)]


def groups_of(sigma: float, interval: float) -> list[str]:
    """The parts of the records that a scene counts in."""
    names = [f"s{sigma:g}-h{interval:g}"]
    if interval >= SLOW and sigma <= CLEAR:
        names.append("clear")
    if interval >= SLOW and sigma == BLURRED:
        names.append("blurred")
    return names


def run_scenes(task: CellTask) -> None:
    """Every class at every setting, its number of bodies another one each time."""
    methods = (OURS, *(b for b in BASELINES if b != "pysindy" or has_pysindy()))
    settings = settings_of(task.sizes.held_out)
    total = len(task.seeds) * len(settings) * len(KINDS)
    done = 0
    for seed in task.seeds:
        marked: dict[str, dict[str, list[Marked]]] = {}
        for number, (sigma, interval) in enumerate(settings):
            for kind in KINDS.values():
                bodies = kind.bodies[(number + seed) % len(kind.bodies)]
                answers = _answers(kind, Setting(sigma, interval, bodies, seed), methods)
                for group in groups_of(sigma, interval):
                    for method, answer in answers.items():
                        marked.setdefault(group, {}).setdefault(method, []).append(answer)
                done += 1
                if task.progress is not None:
                    task.progress(done, total, 0.0)
        for group, by_method in marked.items():
            _record(task, seed, group, by_method)


def _answers(kind: Kind, setting: Setting, methods: Sequence[str]) -> dict[str, Marked]:
    motion = record(kind, setting)
    found = diagnose_motion(motion)
    answers = {OURS: ours(found), "full-menu": full_menu(motion)}
    if found.inference is not None:
        answers["hamiltonian"] = hamiltonian(found.inference)
    if "pysindy" in methods:
        answers["pysindy"] = pysindy(motion)
    return {method: Marked(kind, answer) for method, answer in answers.items()}


def _record(task: CellTask, seed: int, group: str, by_method: dict[str, list[Marked]]) -> None:
    exact = {}
    for method, marked in by_method.items():
        rows = recorder(task, seed, group if method == OURS else f"{group}/{method}", method)
        for metric, holds in scores(marked).items():
            if holds:
                add_share(rows, metric, holds)
        exact[method] = sum(m.exact for m in marked) / len(marked)
    best = max(value for method, value in exact.items() if method != OURS)
    recorder(task, seed, group).add_value("exact_margin", exact[OURS] - best)
    if "pysindy" not in by_method:
        rows = recorder(task, seed, f"{group}/pysindy", "pysindy")
        # pip install vidphys[bench] brings it
        rows.add("exact_structure", Summary(None, "skipped", 0, 0))


DIAGNOSE = Table.told(
    "diagnose",
    cells={
        "scenes": run_scenes,
        "nulls": run_nulls,
        "power": run_power,
        "damping": run_damping,
        "cost": run_cost,
        "switch": run_switch,
        "energy-balance": run_energy_balance,
        "second-law": run_second_law,
    },
    settings={
        "clips": CLIPS,
        "frames": FRAMES,
        "classes": {
            name: sorted(k.truth) if k.truth is not None else "outside the menu"
            for name, k in KINDS.items()
        },
        "settings": [list(s) for s in SETTINGS],
    },
)
