"""Rates of friction: their intervals on the confusion scenes, and the energy balance."""

from __future__ import annotations

from itertools import count

import numpy as np

from vidphys.diagnose.diagnosis import Diagnosis, diagnose_motion
from vidphys.diagnose.inference.menu import FRICTION
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.weak.energy_balance import (
    corrected_rate,
    envelope_rate,
    plain_rate,
    sliding_rates,
)
from vidphys.experiments.confusion.questions import STUDY_RATE, add_share, recorder, switched
from vidphys.experiments.confusion.scenes import (
    KINDS,
    LINEAR,
    SOFTENING,
    Kind,
    Law,
    Setting,
    attracted,
    drag,
    record,
    total,
)
from vidphys.experiments.core.cell import CellTask
from vidphys.statistics import NORMAL_95

DAMPED = ("drag", "trap-drag", "falling-drag", "gravity-drag")
RATES_AT = tuple((s, h) for h in (0.02, 0.04, 0.08) for s in (0.001, 0.005))
BALANCE_CLIPS, BALANCE_FRAMES = 64, 24
CADENCES, NOISES = (0.01, 0.02, 0.04, 0.08), (0.0, 0.005, 0.02)


def run_damping(task: CellTask) -> None:
    """Rates of linear friction with their intervals, where they are to be trusted.

    Each scene has noise of its own: a share of scenes that have the same noise would be known no
    better than from one of them.
    """
    repeats = max(1, task.sizes.held_out // 8)
    for seed in task.seeds:
        found, held, worst = [], [], 0.0
        scene = count(10_000 * seed)
        for sigma, interval in RATES_AT:
            rates = []
            for name in DAMPED:
                for repeat in range(repeats):
                    bodies = (2, 3)[repeat % 2]
                    setting = Setting(sigma, interval, bodies, next(scene))
                    rate = _rate(diagnose_motion(record(KINDS[name], setting)))
                    found.append(rate is not None)
                    if rate is not None:
                        rates.append(rate[0])
                        held.append(abs(rate[0] - LINEAR) <= NORMAL_95 * rate[1])
            bias = abs(float(np.mean(rates)) / LINEAR - 1)
            worst = max(worst, bias)
            recorder(task, seed, f"s{sigma:g}-h{interval:g}").add_value("bias", bias)
        rows = recorder(task, seed)
        rows.add_value("bias_largest", worst)
        add_share(rows, "coverage", held)
        add_share(rows, "found", found)


def _rate(found: Diagnosis) -> tuple[float, float] | None:
    """Rate of a linear friction and its standard error."""
    inference = found.inference
    if inference is None or "linear" not in inference.structure.kinds:
        return None
    term = inference.structure.term(FRICTION)
    assert term is not None
    at = inference.fitted.place(term)
    return float(inference.fitted.values[at]), float(inference.fitted.errors[at])


def potential(q: np.ndarray) -> np.ndarray:
    """V of :func:`vidphys.experiments.confusion.scenes.attracted`, ``(..., n, d) -> (...)``."""
    i, j = np.triu_indices(q.shape[-2], 1)
    squared = ((q[..., i, :] - q[..., j, :]) ** 2).sum(-1)
    return -(1 / np.sqrt(squared + SOFTENING**2)).sum(-1)


def run_energy_balance(task: CellTask) -> None:
    """The balance of energy of three attracting bodies, over cadence and noise."""
    for seed in task.seeds:
        for interval in CADENCES:
            for sigma in NOISES:
                damped = _clips(total(attracted, drag(STUDY_RATE, 1)), sigma, interval, seed)
                rows = recorder(task, seed, f"noise-{sigma:g}/{interval:g}")
                rows.add_value("rate_plain", plain_rate(damped, potential).value)
                rate = corrected_rate(damped, potential)
                rows.add_value("rate_corrected", rate.value)
                rows.add_value("rate_low", rate.low)
                rows.add_value("rate_high", rate.high)
        _study(task, seed)


def _study(task: CellTask, seed: int) -> None:
    """The study's own figures: noise 0.005, 0.08 s."""
    sigma, interval = 0.005, 0.08
    still = _clips(attracted, sigma, interval, seed)
    damped = _clips(total(attracted, drag(STUDY_RATE, 1)), sigma, interval, seed)
    rows = recorder(task, seed, "conservative")
    rate = corrected_rate(still, potential).value
    rows.add_value("rate", rate)
    rows.add_value("rate_size", abs(rate))
    rows.add_value("rate_envelope", envelope_rate(still))
    rows = recorder(task, seed, "damped")
    forward = corrected_rate(damped, potential)
    backward = corrected_rate(damped.reversed(), potential)
    rows.add_value("rate", forward.value)
    rows.add_value("rate_error", abs(forward.value / STUDY_RATE - 1))
    rows.add_value("reversed_over_forward", backward.value / forward.value)
    rows.add_value("carried_reversed", backward.carried)
    at = BALANCE_FRAMES / 2 * interval
    later = _clips(switched(attracted, at), sigma, interval, seed)
    times, rates = sliding_rates(later, potential, sigma=sigma)
    rows = recorder(task, seed, "switch")
    half = interval * 3  # of the sliding window, whose middle is its time
    rows.add_value("rate_before", float(np.median(rates[times + half < at])))
    rows.add_value("rate_after", float(np.median(rates[times - half > at])))


def _clips(law: Law, sigma: float, interval: float, seed: int) -> Motion:
    kind = Kind("balance", law, None)
    return record(kind, Setting(sigma, interval, 3, seed), BALANCE_CLIPS, BALANCE_FRAMES)
