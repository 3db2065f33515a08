"""Questions beside the structure: nulls, coupling powers, switches; and how rows are recorded."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from vidphys import metrics
from vidphys.coupling_verdict import PowerVerdict
from vidphys.diagnose.diagnosis import diagnose_motion
from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.experiments.confusion.scenes import (
    KINDS,
    Kind,
    Law,
    Setting,
    attracted,
    drag,
    free,
    record,
    total,
    trapped,
)
from vidphys.experiments.core.cell import CellTask
from vidphys.runs.records import Recorder

STUDY_RATE = 1.5  # per second (the study's video world)


def recorder(
    task: CellTask,
    seed: int,
    part: str = "",
    method: str = "diagnose",
    grounding: str = "tracks",
    dtype: str = "float64",
) -> Recorder:
    """A recorder of this cell, or of a part of it, for one seed and method."""
    return task.recorder(seed, "confusion", method, part or None, grounding, dtype=dtype)


def add_share(rows: Recorder, metric: str, holds: list[bool]) -> None:
    """Record a share with the yes or no of each scene."""
    values = torch.tensor(holds, dtype=torch.float64)
    rows.add(metric, metrics.mean(values))
    rows.add_episodes(metric, values)


def run_nulls(task: CellTask) -> None:
    """No motion, noise alone, and frames out of order: nothing may be said of them."""
    repeats = max(1, task.sizes.held_out // 4)
    for seed in task.seeds:
        refused = []
        for repeat in range(repeats):
            rng = np.random.default_rng([seed, repeat, 11])
            moving = record(KINDS["gravity"], Setting(0.005, 0.04, 3, 100 * seed + repeat))
            q = moving.positions
            still = np.broadcast_to(q[:, :1], q.shape)
            cases = {
                "at rest": still,
                "at rest, noise": still + 0.005 * rng.standard_normal(q.shape),
                "noise": rng.standard_normal(q.shape),
                "shuffled": q[:, rng.permutation(q.shape[1])],
            }
            found = [diagnose_motion(motion_of(x, 0.04)) for x in cases.values()]
            refused += [bool(f.refused) for f in found]
        add_share(recorder(task, seed), "refused", refused)


def run_power(task: CellTask) -> None:
    """Gravity whose strength goes with G or with |G|, recorded at G > 0 only or at both signs."""
    powers: dict[str, Callable[[np.ndarray], np.ndarray]] = {"linear": lambda g: g, "even": np.abs}
    repeats = max(1, task.sizes.held_out // 16)
    for seed in task.seeds:
        abstained, decided = [], []
        for name, power in powers.items():
            for repeat in range(repeats):
                rng = np.random.default_rng([seed, repeat, 13])
                coupling = rng.uniform(0.5, 1.5, 8)
                verdict = _power_of(coupling, power, seed, repeat)
                both = {"linear", "even"} <= set(verdict.supported) if verdict else False
                asked = verdict is not None and verdict.query is not None and verdict.query < 0
                abstained.append(both and asked)
                coupling[::2] *= -1
                verdict = _power_of(coupling, power, seed, repeat)
                decided.append(verdict is not None and verdict.supported == (name,))
        add_share(recorder(task, seed, "positive"), "abstained", abstained)
        add_share(recorder(task, seed, "both"), "decided", decided)


def _power_of(
    coupling: np.ndarray, power: Callable[[np.ndarray], np.ndarray], seed: int, repeat: int
) -> PowerVerdict | None:
    strength = power(coupling)[:, None, None]

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        return strength * attracted(q, v, t)

    kind = Kind(f"power-{repeat}", law, None)
    seen = record(kind, Setting(0.005, 0.04, 3, seed))
    return diagnose_motion(Motion(seen.positions, seen.times, seen.mass, coupling)).power


def run_switch(task: CellTask) -> None:
    """Friction that sets in at some frame, and clips in which nothing changes."""
    repeats = max(1, task.sizes.held_out // 16)
    for seed in task.seeds:
        found, off, false = [], [], []
        for base in (trapped, attracted, free):
            for repeat in range(repeats):
                rng = np.random.default_rng([seed, repeat, 17])
                frame = int(rng.integers(20, 44))
                setting = Setting(0.005, 0.04, 3, 100 * seed + repeat)
                kind = Kind(f"switch-{repeat}", switched(base, frame * 0.04), None)
                switch = diagnose_motion(record(kind, setting)).switch
                found.append(switch is not None)
                if switch is not None:
                    off.append(abs(switch.frame - frame))
                unchanged = diagnose_motion(record(Kind(f"switch-{repeat}", base, None), setting))
                false.append(unchanged.switch is not None)
        rows = recorder(task, seed)
        add_share(rows, "found", found)
        add_share(rows, "false_switch", false)
        rows.add_value("frames_off_median", float(np.median(off)) if off else float("nan"))


def switched(base: Law, at: float) -> Law:
    """A world that is damped from ``at`` seconds on."""
    damped = total(base, drag(STUDY_RATE, 1))

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        return damped(q, v, t) if t >= at - 1e-9 else base(q, v, t)

    return law
