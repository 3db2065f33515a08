"""What the chosen model costs and misses, over everything on the menu."""

from __future__ import annotations

import time

import numpy as np
import torch

from dynamics import Parameters, PhaseState, build, rollout, terms
from dynamics.terms import HeadTerm
from vidphys.diagnose.diagnosis import diagnose_motion
from vidphys.diagnose.explanations.menu_model import BATH, PORTS, model_of
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import FRICTIONS, PAIR, external_terms, field_of
from vidphys.diagnose.inference.structures import Menu
from vidphys.diagnose.weak.regression import normal_equations, rows_of
from vidphys.experiments.confusion.questions import recorder
from vidphys.experiments.confusion.scenes import KINDS, Setting, record
from vidphys.experiments.core.cell import CellTask

STEPS, BATCH, ROUNDS = 20, 64, 3
HELD_OUT = 4  # one clip in so many
FULL = terms.Hamiltonian(
    potentials=(terms.Radial(), terms.Uniform(), terms.Trap(1.0)),
    ports=(PORTS["square"], PORTS["dry"], BATH),
)


def run_cost(task: CellTask) -> None:
    """Seconds of a step and held-out error: what was chosen, over everything on the menu."""
    for seed in task.seeds:
        compute, errors, of_pairs = [], [], []
        for kind in KINDS.values():
            if kind.truth is None:
                continue
            bodies = kind.bodies[min(1, len(kind.bodies) - 1)]
            found = diagnose_motion(record(kind, Setting(0.005, 0.04, bodies, seed)))
            if found.inference is None:
                continue
            ratio = _compute_ratio(model_of(found.inference), bodies)
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


def _compute_ratio(term: HeadTerm, bodies: int) -> float:
    """Seconds of a step of these terms over those of the full menu, measured in turn."""
    spent: list[list[float]] = [[], []]
    for _ in range(ROUNDS):
        for which, some in enumerate((term, FULL)):
            spent[which].append(_seconds(some, bodies))
    return min(spent[0]) / min(spent[1])


def _seconds(term: HeadTerm, bodies: int) -> float:
    head = build(term, bodies, 0.01)
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
