"""The study's two questions, asked of any head from any start: is it stable, does it invert?"""

from __future__ import annotations

import torch
from torch import Tensor

from dynamics import Head, Parameters, PhaseState, Rollout
from vidphys import metrics
from vidphys.experiments.core.question import INVERSION_STEPS, Question
from vidphys.placement import CPU, moved, suited
from vidphys.runs.records import Recorder

COUPLINGS = (-0.5, -1.0, -1.5)
DRIFT_STEPS = (100, 500, 1000, 2000)
LONG_STEPS = 10_000


def score_inversion(
    recorder: Recorder, head: Head, question: Question, rolled: Rollout | None = None
) -> None:
    """What :func:`score_changed_law` records, at each flipped coupling; and the usual law's error.

    Args:
        recorder: gets the numbers.
        head: is asked.
        question: gives the starts and the length.
        rolled: the head under the law that held, at least as long; rolled here where not given.
    """
    for coupling in COUPLINGS:
        flipped = question.params.with_coupling(coupling)
        usual = question.params.with_coupling(-coupling)
        score_changed_law(recorder, head, question, flipped, usual, coupling)
    rolled = question.ask(head, question.steps) if rolled is None else rolled
    recorder.add("in_distribution_nmse", _in_distribution(rolled, question), None, question.steps)


def score_lost(recorder: Recorder, episodes: int) -> None:
    """A training that diverged has no number, and is counted."""
    lost = metrics.Summary(None, metrics.FAILED, episodes, episodes)
    recorder.add("inversion_nmse", lost, COUPLINGS[1], INVERSION_STEPS)


def score_changed_law(
    recorder: Recorder,
    head: Head,
    question: Question,
    changed: Parameters,
    usual: Parameters,
    label: float | None = None,
) -> None:
    """One counterfactual: is the rollout that of the changed law, or still that of the usual one?

    Args:
        recorder: gets the numbers.
        head: is asked.
        question: gives the starts and the length.
        changed: the law that is asked about.
        usual: the law whose truth a model that ignores the change would follow.
        label: what the records' column ``coupling`` says.
    """
    steps = question.steps
    rolled = question.ask(head, steps, changed)
    record_form(recorder, rolled, label, steps)
    predicted = rolled.states
    reference = question.reference(changed).states
    default = question.reference(usual).states
    straight = question.straight_lines().states
    error = metrics.nmse(predicted, reference)
    floor = metrics.nmse(straight, reference)
    match = metrics.regime_match(predicted, reference, default)
    for name, summary in {
        "inversion_nmse": error,
        "regime_match": match,
        "regime_match_gated": metrics.gated_regime_match(match, error, floor),
        "ballistic_nmse": floor,
        "ballistic_skill": metrics.ratio(error, floor),
        "truth_distance": metrics.nmse(default, reference),
        "force_cosine": metrics.cosine(*forces(head, question, changed)),
    }.items():
        recorder.add(name, summary, label, steps)
    recorder.add_episodes(
        "inversion_nmse", metrics.episode_nmse(predicted, reference), label, steps
    )


def record_form(
    recorder: Recorder, rolled: Rollout, label: float | None, steps: int, kind: str = ""
) -> None:
    """Whether a spline stood for the head, how near its force is, and how near it had to be.

    Args:
        recorder: gets ``compiled``, 0 or 1, and of a spline ``compiled_force_error`` and
            ``compiled_tolerance``, both relative, see :class:`dynamics.compiled.build.Sample`.
        rolled: says what was rolled.
        label: what the records' column ``coupling`` says.
        steps: reference steps up to which it was scored.
        kind: ends the names, of rollouts of another kind.
    """
    report, episodes = rolled.report, len(rolled.states.q)
    numbers = {"compiled": float(report is not None)}
    if report is not None:
        numbers["compiled_force_error"] = report.error
        numbers["compiled_tolerance"] = report.tolerance
    for name, value in numbers.items():
        summary = metrics.Summary(value, metrics.OK, episodes, 0)
        recorder.add(f"{name}{kind}", summary, label, steps)


def score_start(
    recorder: Recorder, head: Head, question: Question, start: PhaseState, name: str
) -> None:
    """Error and skill under each flipped coupling from another start, as ``METRIC_from_NAME``.

    What a head makes of a start that is not its own tells its law from its start.
    """
    other = question.starting(start)
    straight = question.straight_lines().states
    for coupling in COUPLINGS:
        law = question.params.with_coupling(coupling)
        reference = question.reference(law).states
        error = metrics.nmse(other.ask(head, question.steps, law).states, reference)
        skill = metrics.ratio(error, metrics.nmse(straight, reference))
        recorder.add(f"inversion_nmse_from_{name}", error, coupling, question.steps)
        recorder.add(f"ballistic_skill_from_{name}", skill, coupling, question.steps)


def score_fixed_step(recorder: Recorder, head: Head, question: Question, rolled: Rollout) -> None:
    """Energy drift without pieces of a step, and what share of steps the rollout took in pieces.

    Args:
        recorder: gets the numbers.
        head: is asked.
        question: gives the starts.
        rolled: the head under the law that held, with pieces where encounters need them.
    """
    steps, episodes = rolled.states.q.shape[-3] - 1, rolled.states.q.shape[0]
    whole = steps * episodes * round(rolled.dt / question.step_of(head))
    recorder.add_value("steps_in_pieces", rolled.split / max(1, whole))
    fixed = question.ask(head, DRIFT_STEPS[-1], substeps=False)
    record_form(recorder, fixed, None, DRIFT_STEPS[-1], "_fixed_step")
    drift = _drift(question, fixed)
    for horizon in DRIFT_STEPS:
        at = drift[:, horizon // question.every]
        recorder.add("energy_drift_median_fixed_step", metrics.median(at), None, horizon)
        recorder.add("energy_drift_worst_fixed_step", metrics.worst(at), None, horizon)


def forces(head: Head, question: Question, params: Parameters) -> tuple[Tensor, Tensor]:
    """The model's force and the true one at the true starts, ``(b, n, d)``, float64 on the CPU."""
    with torch.no_grad():
        model = moved(head.force(*suited((question.truth, params), head)), CPU, torch.float64)
    return model, question.scene.law.force(question.truth.map(Tensor.double), params)


def _in_distribution(rolled: Rollout, question: Question) -> metrics.Summary:
    truth = question.reference(question.params).states
    states = rolled.states.map(lambda x: x[..., : truth.q.shape[-3], :, :])
    return metrics.nmse(states, truth)


def score_drift(
    recorder: Recorder,
    head: Head,
    question: Question,
    horizons: tuple[int, ...] = DRIFT_STEPS,
    rolled: Rollout | None = None,
) -> Rollout:
    """Energy drift, valid time and latent growth under the law that held; returns the rollout.

    Args:
        recorder: gets the numbers.
        head: is asked.
        question: gives the starts.
        horizons: reference steps, rising.
        rolled: the head under the law that held, at least as long; rolled here where not given.
    """
    rolled = question.ask(head, horizons[-1]) if rolled is None else rolled
    record_form(recorder, rolled, None, horizons[-1])
    drift = _drift(question, rolled)
    for horizon in horizons:
        at = drift[:, horizon // question.every]
        recorder.add("energy_drift_median", metrics.median(at), None, horizon)
        recorder.add("energy_drift_worst", metrics.worst(at), None, horizon)
        recorder.add("energy_drift_over_one", metrics.fraction_over_one(at), None, horizon)
        recorder.add_episodes("energy_drift", at, None, horizon)
    steps = horizons[-1]
    truth = question.reference(question.params, steps).states
    stored = rolled.states.map(lambda x: x[:, : truth.q.shape[1]])
    valid = metrics.valid_time(stored, truth, question.every * question.scene.dt)
    recorder.add("valid_time", metrics.median(valid), None, steps)
    recorder.add_episodes("valid_time", valid, None, steps)
    growth = metrics.latent_growth(rolled.states, steps // question.every)
    recorder.add("latent_growth", growth, None, steps)
    return rolled


def score_rollout_error(recorder: Recorder, question: Question, rolled: Rollout) -> None:
    """Median over episodes of the error at each horizon, in units of the truth's spread."""
    truth = question.reference(question.params, DRIFT_STEPS[-1])
    for horizon in DRIFT_STEPS:
        x = rolled.at(horizon // question.every).flat.double()
        y = truth.at(horizon // question.every).flat
        error = (x - y).square().mean(1).sqrt() / y.std(correction=0)
        recorder.add("rollout_error_median", metrics.median(error), None, horizon)


def score_long_drift(
    recorder: Recorder, head: Head, question: Question, rolled: Rollout | None = None
) -> None:
    """Whether the drift still grows at 10,000 steps: slopes of D(t) over the second half.

    ``energy_drift_slope`` is that of the median over episodes, the statistic that drift is
    reported in, with a bootstrap interval over episodes. ``energy_drift_mean_slope`` is the mean
    of the episodes' own slopes with its normal interval: a few episodes with hard encounters rule
    it. Both are per 1,000 steps.

    Args:
        recorder: gets the numbers.
        head: is asked.
        question: gives the starts.
        rolled: the head over ``LONG_STEPS`` under the law that held; rolled here where not given.
    """
    rolled = question.ask(head, LONG_STEPS) if rolled is None else rolled
    record_form(recorder, rolled, None, LONG_STEPS)
    drift = _drift(question, rolled)
    at = drift[:, -1]
    recorder.add("energy_drift_median", metrics.median(at), None, LONG_STEPS)
    recorder.add("energy_drift_worst", metrics.worst(at), None, LONG_STEPS)
    recorder.add_episodes("energy_drift", at, None, LONG_STEPS)
    late = drift[:, drift.shape[1] // 2 :]
    late = late[torch.isfinite(late).all(1)]
    lost = len(drift) - len(late)
    if len(late) < 2:
        failed = metrics.Summary(None, metrics.FAILED, len(drift), lost)
        recorder.add("energy_drift_slope", failed, None, LONG_STEPS)
        return
    slopes = metrics.slope(late, LONG_STEPS / 2000)
    error = 1.96 * float(slopes.std()) / len(slopes) ** 0.5
    mean = float(slopes.mean())
    low, high = metrics.median_slope_interval(late, LONG_STEPS / 2000)
    for name, value in {
        "energy_drift_slope": float(metrics.slope(late.quantile(0.5, 0), LONG_STEPS / 2000)),
        "energy_drift_slope_low": low,
        "energy_drift_slope_high": high,
        "energy_drift_mean_slope": mean,
        "energy_drift_mean_slope_low": mean - error,
        "energy_drift_mean_slope_high": mean + error,
    }.items():
        summary = metrics.Summary(value, metrics.OK, len(drift), lost)
        recorder.add(name, summary, None, LONG_STEPS)


def _drift(question: Question, rolled: Rollout) -> Tensor:
    energy = question.scene.energy(rolled.states, question.params)
    scale = question.scene.energy_scale(rolled.at(0), question.params)
    return metrics.energy_drift(energy, scale)
