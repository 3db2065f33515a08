"""Families of parameter maps: capacity or the prior, what carries to an unseen sign?."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from dynamics import Head, PhaseState, leapfrog, terms, to_config
from dynamics.building import parameter_count
from dynamics.terms import HeadTerm, PotentialTerm
from vidphys import metrics
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.members import fit_ensemble, is_finite
from vidphys.experiments.core.oracle import HORIZON, held_out_question
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_changed_law
from vidphys.experiments.linear.candidates import (
    ForceLabels,
    candidate,
    fit_ring,
    force_labels,
    response,
)
from vidphys.experiments.linear.factorial import CURL, FLIPPED
from vidphys.placement import CPU, moved, suited
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene
from vidphys.scenes.oscillators import CONFINEMENT, GROUNDED, curl_matrix, oscillators
from vidphys.seeding import derive
from vidphys.training.ensemble import Ensemble, stack

POTENTIALS: dict[str, PotentialTerm] = {
    "multiplicative": terms.Mapped("linear"),
    "gain": terms.Mapped("gain"),
    "direct": terms.FreePotential(),
    "localised": terms.Mapped("localised"),
}
NETWORKS: dict[str, HeadTerm] = {
    name: terms.Hamiltonian(potentials=(potential, terms.Trap(CONFINEMENT)))
    for name, potential in POTENTIALS.items()
}
SCALARS = "eight-scalars"
HELD_OUT = 64  # trajectories' worth of labels that are scored


def _labels(scene: Scene, kind: str, count: int, seed: int) -> ForceLabels:
    """As many labels as ``count`` training trajectories of the other tables have steps."""
    push = curl_matrix(CURL, kind)
    return force_labels(scene, count * HORIZON, push, derive(seed, "maps", kind))


def fit_networks(
    task: CellTask, name: str, kind: str, recorders: Mapping[int, Recorder]
) -> dict[int, Head]:
    """One network for each seed, side by side, on the labels that the linear candidates see."""
    scene = oscillators(kind)
    heads, data = [], []
    for seed in task.seeds:
        torch.manual_seed(derive(seed, "init", name))
        heads.append(scene.build(NETWORKS[name]))
        labels = _labels(scene, kind, task.sizes.trajectories, seed)
        data.append(pytree.tree_map(lambda x: x.float().to(task.device), labels))
    count = HORIZON * max(1, task.sizes.trajectories // 16)
    train = [d[slice(count, None)] for d in data]
    held_out = stack([d[slice(0, count)] for d in data])
    size = data[0].force.square().mean()

    def loss(head: Head, batch: ForceLabels) -> Tensor:
        return (response(head, batch.q, batch.params) - _coupled(batch)).square().mean() / size

    ensemble, order = Ensemble(heads).to(task.device), derive(task.seeds[0], "order", name)
    save_to, progress = task.checkpoint("fit"), task.progress
    choice = fit_ensemble(ensemble, loss, train, held_out, task.sizes, order, save_to, progress)
    fitted: dict[int, Head] = {}
    for seed, head in zip(task.seeds, ensemble.members(), strict=True):
        recorders[seed].add_value("learning_rate", choice.chosen)
        recorders[seed].add_value("training_failed", float(not is_finite(head)))
        if is_finite(head):
            fitted[seed] = head
    return fitted


def _coupled(labels: ForceLabels) -> Tensor:
    return labels.force + CONFINEMENT * labels.q


def maps_cell(name: str, kind: str) -> Cell:
    """A cell that fits one family on one system and asks for the unseen sign."""

    def run(task: CellTask) -> None:
        scene = oscillators(kind)
        recorders = {seed: task.recorder(seed, scene, name) for seed in task.seeds}
        if name in NETWORKS:
            heads = fit_networks(task, name, kind, recorders)
            counts = {seed: parameter_count(head) for seed, head in heads.items()}
        else:
            fits = {
                seed: fit_ring(_labels(scene, kind, task.sizes.trajectories, seed))
                for seed in task.seeds
            }
            heads = {s: candidate("hamiltonian", c, "linear", leapfrog) for s, c in fits.items()}
            counts = dict.fromkeys(heads, 8)
        for seed, head in heads.items():
            question = held_out_question(scene, task.sizes.held_out, seed)
            recorders[seed].add_value("parameters", counts[seed])
            _score(recorders[seed], head, question, kind, seed)

    return run


def _score(recorder: Recorder, head: Head, question: Question, kind: str, seed: int) -> None:
    """The fit in the observed regime, the response at G = -1, and rollouts there."""
    held_out = _labels(question.scene, kind, HELD_OUT, derive(seed, "held out"))
    fitted = _respond(head, held_out)
    error = (fitted - _coupled(held_out)).square().mean() / _coupled(held_out).square().mean()
    recorder.add_value("fit_nmse", float(error))
    truth = ForceLabels(
        held_out.q,
        held_out.params.with_coupling(FLIPPED),
        question.scene.law.force(_still(held_out.q), held_out.params.with_coupling(FLIPPED)),
    )
    answered = _respond(head, truth)
    error = (answered - _coupled(truth)).square().mean() / _coupled(truth).square().mean()
    recorder.add("response_nmse", metrics.Summary(float(error), metrics.OK, len(truth), 0), FLIPPED)
    recorder.add("response_cosine", metrics.cosine(answered, _coupled(truth)), FLIPPED)
    changed = question.params.with_coupling(FLIPPED)
    usual = question.params.with_coupling(-FLIPPED)
    score_changed_law(recorder, head, question, changed, usual, FLIPPED)


def _respond(head: Head, labels: ForceLabels) -> Tensor:
    """The response in float64, asked of the head in its own precision."""
    with torch.no_grad():
        answer = response(head, *suited((labels.q, labels.params), head))
    return moved(answer, CPU, torch.float64)


def _still(q: Tensor) -> PhaseState:
    return PhaseState(q, torch.zeros_like(q))


MAPS = Table.told(
    "maps",
    cells={
        f"{kind}-{name}": maps_cell(name, kind)
        for kind in GROUNDED
        for name in (SCALARS, *NETWORKS)
    },
    settings={
        "scenes": {kind: oscillators(kind).settings for kind in GROUNDED},
        "heads": {name: to_config(term) for name, term in NETWORKS.items()},
        "curl": CURL,
    },
)
