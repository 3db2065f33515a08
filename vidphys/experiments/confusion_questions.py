"""Questions beside the structure: rates and their intervals, switches, powers, cost, nulls."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch

from dynamics import HamiltonianTerms, Parameters, PhaseState, Terms, build, rollout
from vidphys import metrics
from vidphys.coupling_power import PowerVerdict
from vidphys.diagnose.diagnosis import Diagnosis, diagnose
from vidphys.diagnose.energy_balance import (
    corrected_rate,
    envelope_rate,
    plain_rate,
    sliding_rates,
)
from vidphys.diagnose.inference import Inference
from vidphys.diagnose.menu import FRICTION, FRICTIONS, PAIR, external_terms, field_of
from vidphys.diagnose.motion import Motion, motion_of
from vidphys.diagnose.regression import normal_equations, rows_of
from vidphys.diagnose.specification import BATH, PORTS, terms_of
from vidphys.diagnose.structures import Menu
from vidphys.experiments.confusion import (
    KINDS,
    LINEAR,
    SOFTENING,
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
from vidphys.experiments.tables.base import CellTask
from vidphys.runs.records import Origin, Recorder
from vidphys.statistics import NORMAL_95

DAMPED = ("drag", "trap-drag", "falling-drag", "gravity-drag")
RATES_AT = tuple((s, h) for h in (0.02, 0.04, 0.08) for s in (0.001, 0.005))
STUDY_RATE = 1.5  # per second (the study's video world)
BALANCE_CLIPS, BALANCE_FRAMES = 64, 24
CADENCES, NOISES = (0.01, 0.02, 0.04, 0.08), (0.0, 0.005, 0.02)
STEPS, BATCH, ROUNDS = 20, 64, 3
HELD_OUT = 4  # one clip in so many
FULL: Terms = HamiltonianTerms(
    potential="radial",
    trap=1.0,
    uniform=True,
    ports=(PORTS["square"], PORTS["dry"], BATH),
)


def recorder(
    task: CellTask,
    seed: int,
    part: str = "",
    method: str = "diagnose",
    grounding: str = "tracks",
    dtype: str = "float64",
) -> Recorder:
    """A recorder of this cell, or of a part of it, for one seed and method."""
    name = task.cell if not part else f"{task.cell}/{part}"
    origin = Origin(
        experiment=task.table,
        cell=name,
        system="confusion",
        grounding=grounding,
        encoder="none",
        binder="none",
        readout="none",
        head=method,
        seed=seed,
        device=task.device,
        dtype=dtype,
    )
    task.recorders.append(Recorder(origin))
    return task.recorders[-1]


def add_share(rows: Recorder, metric: str, holds: list[bool]) -> None:
    """Record a share with the yes or no of each scene."""
    values = torch.tensor(holds, dtype=torch.float64)
    rows.add(metric, metrics.mean(values))
    rows.add_episodes(metric, values)


def run_nulls(task: CellTask) -> None:
    """No motion, noise alone, and frames out of order: nothing may be said of them."""
    for seed in task.seeds:
        rng = np.random.default_rng([seed, 11])
        moving = record(KINDS["gravity"], Setting(0.005, 0.04, 3, seed)).positions
        still = np.broadcast_to(moving[:, :1], moving.shape)
        cases = {
            "at rest": still,
            "at rest, noise": still + 0.005 * rng.standard_normal(moving.shape),
            "noise": rng.standard_normal(moving.shape),
            "shuffled": moving[:, rng.permutation(moving.shape[1])],
        }
        found = [diagnose(motion_of(x, 0.04)) for x in cases.values()]
        add_share(recorder(task, seed), "refused", [bool(f.refused) for f in found])


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
    return diagnose(Motion(seen.positions, seen.times, seen.mass, coupling)).power


def run_damping(task: CellTask) -> None:
    """Rates of linear friction with their intervals, where they are to be trusted."""
    repeats = max(1, task.sizes.held_out // 8)
    for seed in task.seeds:
        found, held, worst = [], [], 0.0
        for sigma, interval in RATES_AT:
            rates = []
            for name in DAMPED:
                for repeat in range(repeats):
                    bodies = (2, 3)[repeat % 2]
                    setting = Setting(sigma, interval, bodies, 1000 * seed + repeat)
                    rate = _rate(diagnose(record(KINDS[name], setting)))
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


def run_cost(task: CellTask) -> None:
    """Seconds of a step and held-out error: what was chosen, over everything on the menu."""
    for seed in task.seeds:
        compute, errors, of_pairs = [], [], []
        for kind in KINDS.values():
            if kind.truth is None:
                continue
            bodies = kind.bodies[min(1, len(kind.bodies) - 1)]
            found = diagnose(record(kind, Setting(0.005, 0.04, bodies, seed)))
            if found.inference is None:
                continue
            ratio = _compute_ratio(terms_of(found.kinds, trap=1.0), bodies)
            compute.append(ratio)
            errors.append(_held_out_ratio(found.inference))
            if found.inference.structure.term(PAIR) is not None:
                of_pairs.append(ratio)
        rows = recorder(task, seed)
        rows.add_value("compute_ratio_median", float(np.median(compute)))
        rows.add_value("held_out_ratio_median", float(np.median(errors)))
        rows.add_value("compute_ratio_pairs", float(np.median(of_pairs)))
        rows.add_episodes("compute_ratio", torch.tensor(compute))
        rows.add_episodes("held_out_ratio", torch.tensor(errors))


def _compute_ratio(terms: Terms, bodies: int) -> float:
    """Seconds of a step of these terms over those of the full menu, measured in turn."""
    spent: list[list[float]] = [[], []]
    for _ in range(ROUNDS):
        for which, some in enumerate((terms, FULL)):
            spent[which].append(_seconds(some, bodies))
    return min(spent[0]) / min(spent[1])


def _seconds(terms: Terms, bodies: int) -> float:
    head = build(terms, bodies, 0.01)
    q = torch.randn(BATCH, bodies, 2)
    one = torch.ones(BATCH)
    scalars = {"friction": one, "temperature": one}
    params = Parameters(one, torch.ones(BATCH, bodies), scalars=scalars)
    rollout(head, PhaseState(q, torch.zeros_like(q)), params, 2, 0.01)
    began = time.perf_counter()
    rollout(head, PhaseState(q, torch.zeros_like(q)), params, STEPS, 0.01)
    return time.perf_counter() - began


def _held_out_ratio(inference: Inference) -> float:
    """Held-out misfit of the chosen terms over that of the full menu, fitted to other clips."""
    windows, structure = inference.windows, inference.structure
    field = field_of(windows, inference.fitted.paths)
    pair = structure.term(PAIR)
    fixed = [external_terms(windows.frames.shape[-1], False)[1], *FRICTIONS.values()]
    menu = Menu((*structure.terms, *(t for t in fixed if t.kind not in structure.kinds)))
    if pair is None and windows.frames.shape[2] > 1:
        extra = [s.term(PAIR) for s in inference.structures if s.term(PAIR) is not None]
        menu = Menu((*menu.terms, *(t for t in extra[:1] if t is not None)))
    rows = rows_of(windows, menu.columns(field))
    ratio = inference.kicks / inference.fitted.variance
    out = (windows.clip % HELD_OUT == 0)[rows.window]
    train, test = (normal_equations(rows, ratio, keep) for keep in (~out, out))
    chosen = [
        i for t, p in zip(menu.terms, menu.places, strict=True) if t in structure.terms for i in p
    ]
    everything = list(range(len(train.moment)))
    misfits = [test.misfit(columns, train.solve(columns)) for columns in (chosen, everything)]
    return misfits[0] / misfits[1]


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
                kind = Kind(f"switch-{repeat}", _switched(base, frame * 0.04), None)
                switch = diagnose(record(kind, setting)).switch
                found.append(switch is not None)
                if switch is not None:
                    off.append(abs(switch.frame - frame))
                unchanged = diagnose(record(Kind(f"switch-{repeat}", base, None), setting))
                false.append(unchanged.switch is not None)
        rows = recorder(task, seed)
        add_share(rows, "found", found)
        add_share(rows, "false_switch", false)
        rows.add_value("frames_off_median", float(np.median(off)) if off else float("nan"))


def _switched(base: Law, at: float) -> Law:
    damped = total(base, drag(STUDY_RATE, 1))

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        return damped(q, v, t) if t >= at - 1e-9 else base(q, v, t)

    return law


def potential(q: np.ndarray) -> np.ndarray:
    """V of :func:`vidphys.experiments.confusion.attracted`, ``(..., n, d) -> (...)``."""
    i, j = np.triu_indices(q.shape[-2], 1)
    squared = ((q[..., i, :] - q[..., j, :]) ** 2).sum(-1)
    return -(1 / np.sqrt(squared + SOFTENING**2)).sum(-1)


def run_energy_balance(task: CellTask) -> None:
    """X1-X5 in the study's world of three attracting bodies, over cadence and noise."""
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
    switched = _clips(_switched(attracted, at), sigma, interval, seed)
    times, rates = sliding_rates(switched, potential, sigma=sigma)
    rows = recorder(task, seed, "switch")
    half = interval * 3  # of the sliding window, whose middle is its time
    rows.add_value("rate_before", float(np.median(rates[times + half < at])))
    rows.add_value("rate_after", float(np.median(rates[times - half > at])))


def _clips(law: Law, sigma: float, interval: float, seed: int) -> Motion:
    kind = Kind("balance", law, None)
    return record(kind, Setting(sigma, interval, 3, seed), BALANCE_CLIPS, BALANCE_FRAMES)
