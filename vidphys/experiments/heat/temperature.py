"""What stochastic heads are asked: the steady temperature, energy at negative friction, growth."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from dynamics import Head, NoSteadyState, Parameters, PhaseState, Rollout, rollout
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_changed_law
from vidphys.experiments.heat.thermal import Measured, kinetic_temperature, measure_temperature
from vidphys.placement import CPU, moved, suited
from vidphys.runs.records import Recorder
from vidphys.scenes.langevin import BathScene
from vidphys.seeding import derive
from vidphys.summary import FAILED, OK, Summary

WALKERS = 16  # independent walkers for each held-out episode of the preset, in each setting
BURN_IN, MEASURED = 20.0, 60.0  # seconds: ten relaxation times of the slowest bath, and then
EVERY = 5  # steps between stored states
BLOCK = 16  # stored states: 4 s

Setting = Mapping[str, float]


@dataclass(frozen=True)
class Walkers:
    """Independent starts, ``each`` for every setting, one setting after the other.

    Args:
        start: hot states.
        params: with the settings' strengths.
        each: walkers of one setting.
        settings: strengths by name.
    """

    start: PhaseState
    params: Parameters
    each: int
    settings: tuple[Setting, ...]

    def of(self, index: int) -> slice:
        """Those of one setting."""
        return slice(index * self.each, (index + 1) * self.each)


def walkers(scene: BathScene, settings: Sequence[Setting], each: int, seed: int) -> Walkers:
    """Fresh walkers that no training saw."""
    rng = Generator().manual_seed(derive(seed, "walkers"))
    start, params = scene.sample(len(settings) * each, rng)
    for name in settings[0]:
        values = torch.tensor([setting[name] for setting in settings], dtype=torch.float64)
        params = params.with_scalar(name, values.repeat_interleave(each))
    return Walkers(start, params, each, tuple(settings))


def follow(head: Head, scene: BathScene, crowd: Walkers, seconds: float, seed: int) -> Rollout:
    """Roll all walkers as the head computes, storing each ``EVERY``-th step."""
    start, params = suited((crowd.start, crowd.params), head)
    steps = EVERY * round(seconds / scene.dt / EVERY)
    with warnings.catch_warnings():
        # Whoever follows walkers asks `flags` too, and records the answer.
        warnings.simplefilter("ignore", NoSteadyState)
        rolled = rollout(head, start, params, steps, scene.dt, EVERY, derive(seed, "follow"))
    return moved(rolled, CPU)


def flags(head: Head, params: Parameters) -> bool:
    """Whether a head says by name that these parameters have no steady state."""
    return any(finding.kind is NoSteadyState for finding in head.concerns(params))


def temperature_series(rolled: Rollout) -> Tensor:
    """Kinetic temperature ``(walkers, t)``; NaN throughout for a walker that was lost."""
    series = kinetic_temperature(rolled.states, rolled.params.mass)
    return torch.where(rolled.finite.unsqueeze(1), series, torch.nan)


def temperatures(
    head: Head, scene: BathScene, crowd: Walkers, seed: int
) -> tuple[list[Measured], Tensor]:
    """The measured temperature of each setting, and each walker's own, ``(walkers,)``."""
    rolled = follow(head, scene, crowd, BURN_IN + MEASURED, seed)
    late = temperature_series(rolled)[:, round(BURN_IN / rolled.dt) + 1 :]
    rng = Generator().manual_seed(derive(seed, "bootstrap"))
    settings = range(len(crowd.settings))
    return [measure_temperature(late[crowd.of(i)], BLOCK, rng) for i in settings], late.mean(1)


def simulated(scene: BathScene, crowd: Walkers, seed: int) -> list[Measured]:
    """What the simulator shows in each setting, measured as a head is."""
    return temperatures(scene.exact, scene, crowd, derive(seed, "truth"))[0]


def known(values: Sequence[float]) -> list[Measured]:
    """Temperatures that are not measured but derived."""
    return [Measured(value, 0.0, 0, 0) for value in values]


def score_temperatures(
    whole: Recorder,
    parts: Sequence[tuple[Recorder, float | None]],
    head: Head,
    scene: BathScene,
    crowd: Walkers,
    truth: Sequence[Measured],
) -> None:
    """The temperature's error in each setting and the worst of them.

    The error is relative to what the simulator itself shows; its standard error is that of both
    measurements.

    Args:
        whole: gets the worst, the least, and the largest standard error.
        parts: for each setting, the recorder and what its column ``coupling`` says.
        head: is measured.
        scene: gives the step.
        crowd: the settings' walkers.
        truth: the temperature of each setting, see :func:`simulated` and :func:`known`.
    """
    found, each = temperatures(head, scene, crowd, derive(whole.origin.seed, "head"))
    against = [_against(mine, true) for mine, true in zip(found, truth, strict=True)]
    for index, (recorder, label) in enumerate(parts):
        mine, true, (error, spread) = found[index], truth[index], against[index]
        for name, value in {
            "kinetic_temperature": mine.value,
            "simulator_temperature": true.value,
            "temperature_error": error,
            "temperature_standard_error": spread,
        }.items():
            recorder.add(name, _summary(value, mine.walkers, mine.lost), label)
        recorder.add_episodes("kinetic_temperature", each[crowd.of(index)], label)
    lost = sum(m.lost for m in found)
    errors = [error for error, _ in against if error is not None]
    spreads = [spread for _, spread in against if spread is not None]
    all_known = len(errors) == len(against)
    for name, value in {
        "worst_temperature_error": max(errors, default=None),
        "least_temperature_error": min(errors, default=None),
        "worst_standard_error": max(spreads, default=None),
    }.items():
        whole.add(name, _summary(value if all_known else None, len(each), lost))


def _against(mine: Measured, true: Measured) -> tuple[float | None, float | None]:
    """Relative error of one temperature against another, and its standard error."""
    assert true.value is not None, "the simulator lost a walker"
    if mine.value is None:
        return None, None
    ratio = mine.value / true.value
    return abs(ratio - 1), math.hypot(mine.error, true.error * ratio) / true.value


def _summary(value: float | None, episodes: int, lost: int) -> Summary:
    return Summary(value, FAILED if value is None else OK, episodes, lost)


INVERTED, INVERSION_STEPS = -0.5, 20  # friction per second, and one second of it


def score_injection(recorder: Recorder, head: Head, scene: BathScene, crowd: Walkers) -> None:
    """Energy gained at negative friction and temperature 0, where no noise is defined.

    ``injection_rate`` is the mean gain over one second, per mean kinetic energy of the starts;
    they are steady states of the (single) setting. The rollouts are scored as any other changed
    law too.
    """
    seed = recorder.origin.seed
    settled = follow(scene.exact, scene, crowd, BURN_IN, derive(seed, "settle")).at(-1)
    cold = crowd.params.with_scalar("temperature", 0.0)
    changed = cold.with_scalar("friction", INVERTED)
    usual = cold.with_scalar("friction", -INVERTED)
    question = Question(scene, settled, settled, changed, INVERSION_STEPS)
    with warnings.catch_warnings(), torch.random.fork_rng([]):
        warnings.simplefilter("ignore", NoSteadyState)
        torch.manual_seed(derive(seed, "inversion"))
        score_changed_law(recorder, head, question, changed, usual, INVERTED)
        rate = _injection(question, question.ask(head, INVERSION_STEPS))
        truth = _injection(question, question.reference(changed))
    lost = int((~torch.isfinite(rate)).sum())
    mean, true = float(rate.mean()), float(truth.mean())
    for name, value in {
        "injection_rate": mean,
        "injection_share": abs(mean / true),
        "injection_error": abs(mean / true - 1),
    }.items():
        shown = None if lost else value
        recorder.add(name, _summary(shown, len(rate), lost), INVERTED, INVERSION_STEPS)
    recorder.add_episodes("injection_rate", rate, INVERTED, INVERSION_STEPS)


def _injection(question: Question, rolled: Rollout) -> Tensor:
    """Energy gained per second and per mean kinetic energy of the starts, ``(b,)``."""
    energy = question.scene.energy(rolled.states, question.params)
    seconds = question.steps * question.scene.dt
    kinetic = question.scene.bodies * question.scene.space / 2
    mean = kinetic * kinetic_temperature(rolled.states, rolled.params.mass)[:, 0].mean()
    return (energy[:, -1] - energy[:, 0]) / (seconds * mean)


GROWTH_SECONDS = 40.0
GROWN = 2.0  # the last quarter's temperature over the first's


def score_growth(
    recorder: Recorder, head: Head, scene: BathScene, crowd: Walkers, stable: Walkers
) -> None:
    """Does the energy grow without bound where no steady state exists, and is it said so?

    Args:
        recorder: gets ``diverged_fraction``, ``flagged_fraction`` and ``false_flag_fraction``.
        head: is followed.
        scene: gives the step.
        crowd: settings without a steady state.
        stable: settings with one, which are only asked for false alarms.
    """
    seed = recorder.origin.seed
    rolled = follow(head, scene, crowd, GROWTH_SECONDS, derive(seed, "growth"))
    grown = []
    for index, setting in enumerate(crowd.settings):
        series = temperature_series(rolled)[crowd.of(index)].mean(0)
        quarter = len(series) // 4
        ratio = float(series[-quarter:].mean() / series[:quarter].mean())
        grown.append(not ratio <= GROWN)  # a number that is none has grown
        lost = int((~rolled.finite[crowd.of(index)]).sum())
        shown = ratio if abs(ratio) < float("inf") else None
        recorder.add("temperature_growth", _summary(shown, crowd.each, lost), setting["drive"])
    recorder.add_value("diverged_fraction", sum(grown) / len(grown))
    for name, group in {"flagged_fraction": crowd, "false_flag_fraction": stable}.items():
        told = [flags(head, group.params[group.of(i)]) for i in range(len(group.settings))]
        recorder.add_value(name, sum(told) / len(told))
