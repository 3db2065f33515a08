"""What is asked where energy leaves or enters: at which rate, under which sign, and the way back.

Rates are least-squares slopes of the true energy, over the mean |E| of the starts, so that one
episode that starts near zero energy does not rule them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dynamics import Head, Parameters, PhaseState, Rollout
from dynamics.integrators import Memory
from vidphys import metrics
from vidphys.experiments.core.question import Question
from vidphys.placement import CPU, moved, suited
from vidphys.runs.records import Recorder
from vidphys.summary import FAILED, OK, Summary

RETRACE_BELOW = 0.1  # return error that counts as a match; the study names no threshold
LOST_ENERGY = 1e6  # of the start's scale: an episode beyond it has diverged, finite or not


@dataclass(frozen=True)
class EnergyCourse:
    """Energy of a model's rollout and of the truth's, ``(b, t)`` each, over one time.

    Args:
        model, truth: true energy of the states, joules.
        scale: K + |V| of the starts, ``(b,)``.
        seconds: duration.
    """

    model: Tensor
    truth: Tensor
    scale: Tensor
    seconds: float

    def slopes(self, energy: Tensor) -> Tensor:
        """Per-episode slope over the mean |E| of the starts, ``(b,)``, per second."""
        return metrics.slope(energy, self.seconds) / self.truth[:, 0].abs().mean()

    def diverged(self, energy: Tensor) -> Tensor:
        """Which episodes were lost, ``(b,)``."""
        kept = torch.isfinite(energy) & (energy.abs() < LOST_ENERGY * self.scale[:, None])
        return ~kept.all(1)


def energy_course(
    head: Head, question: Question, params: Parameters, steps: int, fine: int = 1
) -> EnergyCourse:
    """Roll a head and the truth under a law and follow the true energy of both.

    Args:
        head: a vector field is stepped ``fine`` times in each reference step, a map once.
        question: gives scene and starts.
        params: the law.
        steps: reference steps.
        fine: for speeds that grow beyond what the reference step resolves.
    """
    scene = question.scene
    rolled = _ask_finely(head, question, params, steps, 1 if head.dt else fine)
    truth = scene.simulate(question.truth, params, steps, question.every)
    scale = scene.energy_scale(question.truth, params)
    energies = [scene.energy(r.states, params) for r in (rolled, truth)]
    return EnergyCourse(energies[0], energies[1], scale, steps * scene.dt)


def _ask_finely(
    head: Head, question: Question, params: Parameters, steps: int, fine: int
) -> Rollout:
    if fine == 1:
        return question.ask(head, steps, params)
    scene = replace(question.scene, dt=question.scene.dt / fine)
    finer = replace(question, scene=scene, every=question.every * fine)
    return finer.ask(head, steps * fine, params)


def score_shed(
    recorder: Recorder,
    head: Head,
    question: Question,
    params: Parameters,
    steps: int,
    kind: str,
    fine: int = 1,
) -> None:
    """The rate at which a rollout's energy changes, against the truth's.

    Args:
        recorder: gets ``KIND_rate``, ``true_KIND_rate``, ``KIND_ratio`` and ``KIND_error``.
        head: is asked.
        question: gives the starts.
        params: the law, with its friction.
        steps: reference steps.
        kind: ``shed``, or ``anti_shed`` under a negative friction.
        fine: see :func:`energy_course`.
    """
    course = energy_course(head, question, params, steps, fine)
    model, truth = course.slopes(course.model), course.slopes(course.truth)
    rate, true = _mean(model), _mean(truth)
    recorder.add(f"{kind}_rate", rate, None, steps)
    recorder.add(f"true_{kind}_rate", true, None, steps)
    recorder.add_episodes(f"{kind}_rate", model, None, steps)
    recorder.add_episodes(f"true_{kind}_rate", truth, None, steps)
    share = metrics.ratio(rate, true)
    error = share if share.value is None else replace(share, value=abs(share.value - 1))
    recorder.add(f"{kind}_ratio", share, None, steps)
    recorder.add(f"{kind}_error", error, None, steps)


def _mean(values: Tensor) -> Summary:
    lost = int((~torch.isfinite(values)).sum())
    if lost:
        return Summary(None, FAILED, len(values), lost)
    return Summary(float(values.mean()), OK, len(values), 0)


def opposed(params: Parameters) -> Parameters:
    """The same law with friction of the opposite sign."""
    return params.with_scalar("friction", -params.scalar("friction"))


def score_refusal(recorder: Recorder, head: Head, params: Parameters) -> bool:
    """``anti_refused``: whether the head refuses parameters, as a guarantee must."""
    try:
        head.check(params)
    except ValueError:
        refused = True
    else:
        refused = False
    recorder.add_value("anti_refused", float(refused))
    return refused


def score_divergence(
    recorder: Recorder, head: Head, question: Question, steps: int, fine: int
) -> None:
    """Which episodes are lost under a negative friction, by the model and by the law itself."""
    course = energy_course(head, question, opposed(question.params), steps, fine)
    model, truth = course.diverged(course.model), course.diverged(course.truth)
    for name, values in {
        "anti_diverged_share": model,
        "true_anti_diverged_share": truth,
        "anti_diverged_agreement": model == truth,
    }.items():
        share = Summary(float(values.double().mean()), OK, len(values), 0)
        recorder.add(name, share, None, steps)
        recorder.add_episodes(name, values.double(), None, steps)


def score_retrace(recorder: Recorder, head: Head, question: Question) -> None:
    """Go on, turn the momenta round, go on as long; is one back? For model and truth."""
    scene, params, steps, truth = question.scene, question.params, question.steps, question.truth
    there = scene.simulate(truth, params, steps, steps).at(-1)
    back = scene.simulate(there.reversed, params, steps, steps).at(-1).reversed
    error = _return_error(_there_and_back(head, question), question.start)
    true = _return_error(back, truth)
    recorder.add("retrace_nmse", error, None, steps)
    recorder.add("true_retrace_nmse", true, None, steps)
    if error.value is not None and true.value:
        match = Summary(float(error.value < RETRACE_BELOW), OK, error.episodes, 0)
        recorder.add("retrace_match", match, None, steps)
        recorder.add("retrace_ratio", metrics.ratio(error, true), None, steps)


def _there_and_back(head: Head, question: Question) -> PhaseState:
    """The model's own way; what its integrator carries along is turned round too."""
    state, params = suited((question.start, question.params), head)
    dt = question.scene.dt if head.dt is None else head.dt
    steps = round(question.steps * question.scene.dt / dt)
    memory: Memory = None
    with torch.no_grad():
        for step in range(2 * steps):
            if step == steps:
                state = state.reversed
                # The shadow copy of Tao's scheme; a stored force is computed afresh.
                memory = memory.reversed if isinstance(memory, PhaseState) else None
            state, memory = head.advance(state, params, dt, memory)
    return moved(state.reversed, CPU)


def _return_error(back: PhaseState, start: PhaseState) -> Summary:
    one_time = [x.map(lambda y: y.unsqueeze(1)) for x in (back, start)]
    return metrics.nmse(*one_time)
