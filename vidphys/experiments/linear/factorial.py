"""The matched factorial: representation, parameter map and integrator, one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import torch
from torch import Generator, Tensor

from dynamics import INTEGRATORS, Head, Parameters, PhaseState, ballistic
from vidphys import metrics
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.core.oracle import held_out_question
from vidphys.experiments.core.truth import score_truth
from vidphys.experiments.linear.candidates import (
    REPRESENTATIONS,
    ForceLabels,
    candidate,
    fit_stiffness,
    force_labels,
    response,
    roll_linear,
)
from vidphys.scenes import Scene
from vidphys.scenes.oscillators import CONFINEMENT, GROUNDED, curl_matrix, oscillators
from vidphys.seeding import derive
from vidphys.statistics import holm, paired_difference, sign_flip_p
from vidphys.training.ensemble import register, stack

register(ForceLabels)

PAIRS = 12  # paired runs, the study's twelve seeds; each seed of ours repeats all of them
METHODS = ("leapfrog", "rk4", "implicit_midpoint")
STEPS = (0.02, 0.05, 0.1)  # seconds
HEADLINE = 0.05  # seconds, the step of the study's table
SECONDS = 40.0  # of a rollout
STORED = 0.1  # seconds between stored states
CURL = 0.03  # of the headline factorial, as a share of the coupling's stiffness
CURLS = (0.0, 0.03, 0.06, 0.1)
FLIPPED = -1.0
ESCAPE = 10.0  # an episode has escaped if its state grew by more than this
FAMILIES = ("linear", "localised")


@dataclass(frozen=True)
class Trial:
    """Twelve paired runs of one system; every tensor has the axis of pairs first.

    Args:
        scene: the truth.
        labels: to fit, ``(pairs, m, ...)``.
        held_out: labels of the same kind that no fit saw.
        start, params: of the rollouts, ``(pairs, episodes, ...)``.
    """

    scene: Scene
    labels: ForceLabels
    held_out: ForceLabels
    start: PhaseState
    params: Parameters


def make_trial(task: CellTask, kind: str, curl: float, seed: int, pairs: int = PAIRS) -> Trial:
    """Draw the runs; another amount of curl contaminates the same states and noise."""
    scene, push = oscillators(kind), curl_matrix(curl, kind)
    numbers = [derive(seed, kind, str(pair)) for pair in range(pairs)]
    drawn = [
        scene.sample(task.sizes.held_out, Generator().manual_seed(derive(n, "test")))
        for n in numbers
    ]
    size = task.sizes.trajectories

    def labels(what: str, count: int) -> ForceLabels:
        return stack([force_labels(scene, count, push, derive(n, what)) for n in numbers])

    start, params = stack(drawn)
    return Trial(scene, labels("fit", size), labels("held out", size // 4), start, params)


def rollout_scores(trial: Trial, head: Head, dt: float) -> dict[str, Tensor]:
    """What a pair's rollouts give in the observed regime, each ``(pairs,)``."""
    steps, every = round(SECONDS / dt), round(STORED / dt)
    states = roll_linear(head, trial.start, trial.params, steps, dt, every)
    scene = replace(trial.scene, dt=STORED)
    truth = scene.simulate(trial.start, trial.params, round(SECONDS / STORED)).states
    energy = scene.law.energy(states, trial.params.map(lambda x: x.unsqueeze(2)))
    error = (energy / energy[..., :1] - 1).abs().amax(-1)
    size = states.flat.norm(dim=-1)
    escaped = (size.amax(-1) > ESCAPE * size[..., 0]).double()
    distance = (states.flat - truth.flat).square().mean((1, 2, 3))
    return {
        "energy_error": error.mean(1),
        "trajectory_nmse": distance / truth.flat.flatten(1).var(1, correction=0),
        "escape_fraction": escaped.mean(1),
    }


def fit_scores(trial: Trial, head: Head) -> dict[str, Tensor]:
    """How well the labels are fitted, and the response at the unseen coupling, ``(pairs,)``."""
    labels = trial.held_out
    fitted = response(head, labels.q, labels.params)
    wanted = labels.force + CONFINEMENT * labels.q
    flipped = trial.params.with_coupling(FLIPPED)
    truth = trial.scene.law.force(trial.start, flipped) + CONFINEMENT * trial.start.q
    answered = response(head, trial.start.q, flipped)
    norm = (truth.flatten(1).norm(dim=1) * answered.flatten(1).norm(dim=1)).clamp_min(1e-300)
    return {
        "fit_nmse": _relative(fitted, wanted),
        "response_nmse": _relative(answered, truth),
        "response_cosine": (answered * truth).sum((1, 2, 3)) / norm,
    }


def _relative(x: Tensor, y: Tensor) -> Tensor:
    return (x - y).square().sum((1, 2, 3)) / y.square().sum((1, 2, 3))


def counterfactual_scores(trial: Trial, head: Head) -> dict[str, Tensor]:
    """Rollouts at the unseen coupling, and the zero-force predictor's, ``(pairs,)``."""
    flipped = trial.params.with_coupling(FLIPPED)
    scene = replace(trial.scene, dt=STORED)
    truth = scene.simulate(trial.start, flipped, round(SECONDS / STORED)).states
    steps, every = round(SECONDS / HEADLINE), round(STORED / HEADLINE)
    variance = truth.flat.flatten(1).var(1, correction=0)
    errors = {}
    for name, law in (("inversion_nmse", head), ("ballistic_nmse", ballistic())):
        states = roll_linear(law, trial.start, flipped, steps, HEADLINE, every)
        errors[name] = (states.flat - truth.flat).square().mean((1, 2, 3)) / variance
    return {**errors, "ballistic_skill": errors["inversion_nmse"] / errors["ballistic_nmse"]}


Scores = dict[tuple[str, str, str, str, float], dict[str, Tensor]]


def run_factorial(task: CellTask) -> None:
    """Every combination on both systems, and the tests of the declared family."""
    for seed in task.seeds:
        rolled: Scores = {}
        answers: dict[tuple[str, str, str], dict[str, Tensor]] = {}
        for kind in GROUNDED:
            trial = make_trial(task, kind, CURL, seed)
            question = held_out_question(trial.scene, task.sizes.held_out, seed)
            score_truth(task.recorder(seed, trial.scene, "truth", f"{kind}/truth"), question)
            for representation, family in product(REPRESENTATIONS, FAMILIES):
                content = fit_stiffness(trial.labels, family).unsqueeze(1)
                for method, dt in product(METHODS, STEPS):
                    head = candidate(representation, content, family, INTEGRATORS[method])
                    key = (kind, representation, family, method, dt)
                    rolled[key] = rollout_scores(trial, head, dt)
                    _record(task, seed, trial.scene, key, rolled[key])
                head = candidate(representation, content, family, INTEGRATORS[METHODS[0]])
                answer = fit_scores(trial, head) | counterfactual_scores(trial, head)
                answers[kind, representation, family] = answer
                _record(task, seed, trial.scene, (kind, representation, family), answer, FLIPPED)
        _summarise(task, seed, rolled, answers)


def _record(
    task: CellTask,
    seed: int,
    scene: Scene,
    key: tuple[str | float, ...],
    scores: Mapping[str, Tensor],
    coupling: float | None = None,
) -> None:
    recorder = task.recorder(seed, scene, "/".join(map(str, key[1:3])), "/".join(map(str, key)))
    for name, values in scores.items():
        at = None if name == "fit_nmse" else coupling
        recorder.add(name, metrics.mean(values), at)
        recorder.add_episodes(name, values, at)


def _summarise(
    task: CellTask,
    seed: int,
    rolled: Scores,
    answers: Mapping[tuple[str, str, str], Mapping[str, Tensor]],
) -> None:
    """The study's ranges over systems and cells at its step, and Holm's p over six tests."""
    at_headline = {key: scores for key, scores in rolled.items() if key[-1] == HEADLINE}
    means: dict[tuple[str, str], list[float]] = {}
    for name in ("energy_error", "trajectory_nmse", "escape_fraction"):
        for representation in REPRESENTATIONS:
            mine = [s[name] for key, s in at_headline.items() if key[1] == representation]
            means[name, representation] = [float(x.mean()) for x in mine]
            recorder = task.recorder(seed, oscillators(), representation, representation)
            found = torch.tensor(means[name, representation], dtype=torch.float64)
            recorder.add_value(f"{name}_smallest", float(found.min()))  # NaN where one is
            recorder.add_value(f"{name}_largest", float(found.max()))
    tests = task.recorder(seed, oscillators(), "all", "tests")
    for name in ("energy_error", "trajectory_nmse"):
        free, held = (
            torch.tensor(means[name, representation], dtype=torch.float64)
            for representation in ("unrestricted", "hamiltonian")
        )
        tests.add_value(f"{name}_ratio_smallest", float((free / held).min()))
    mismatch = [
        answers[kind, r, "localised"]["fit_nmse"] / answers[kind, r, "linear"]["fit_nmse"]
        for kind, r in product(GROUNDED, REPRESENTATIONS)
    ]
    ratios = torch.stack([x.mean() for x in mismatch])
    tests.add_value("fit_ratio_largest", float(ratios.max()))
    samples: dict[str, tuple[Tensor, Tensor]] = {}
    for kind in GROUNDED:
        for name in ("energy_error", "trajectory_nmse"):
            samples[f"{name}/{kind}"] = _pair_means(at_headline, kind, name)
        near, far = (answers[kind, "hamiltonian", f]["response_nmse"] for f in FAMILIES)
        samples[f"response_nmse/{kind}"] = (far, near)
    adjusted = holm([sign_flip_p(a.tolist(), b.tolist()) for a, b in samples.values()])
    for (name, (a, b)), p in zip(samples.items(), adjusted, strict=True):
        interval = paired_difference(a.tolist(), b.tolist())
        test = task.recorder(seed, oscillators(), "all", f"tests/{name}")
        test.add_value("holm_p", p)
        test.add_value("paired_difference", interval.mean)
        if interval.low is not None and interval.high is not None:
            test.add_value("paired_difference_low", interval.low)
            test.add_value("paired_difference_high", interval.high)
    tests.add_value("holm_p_largest", float(torch.tensor(adjusted, dtype=torch.float64).max()))


def _pair_means(at_headline: Scores, kind: str, name: str) -> tuple[Tensor, Tensor]:
    """A pair's mean over maps and integrators: (unrestricted, hamiltonian)."""
    both = [
        torch.stack([s[name] for key, s in at_headline.items() if key[:2] == (kind, r)]).mean(0)
        for r in REPRESENTATIONS
    ]
    return both[1], both[0]


def run_curl(task: CellTask) -> None:
    """How the energy error grows with the share of curl in the labels."""
    for seed, curl in product(task.seeds, CURLS):
        for kind, representation in product(GROUNDED, REPRESENTATIONS):
            trial = make_trial(task, kind, curl, seed)
            content = fit_stiffness(trial.labels, "linear").unsqueeze(1)
            head = candidate(representation, content, "linear", INTEGRATORS["leapfrog"])
            key = (kind, representation, f"curl-{curl:g}")
            _record(task, seed, trial.scene, key, rollout_scores(trial, head, HEADLINE))


SETTINGS = {
    "scenes": {kind: oscillators(kind).settings for kind in GROUNDED},
    "pairs": PAIRS,
    "steps_seconds": STEPS,
    "rollout_seconds": SECONDS,
    "curl": CURL,
}
FACTORIAL = Table.told("factorial", cells={"oscillators": run_factorial}, settings=SETTINGS)
CURL_TABLE = Table.told(
    "curl", cells={"oscillators": run_curl}, settings={**SETTINGS, "curl": CURLS}
)
