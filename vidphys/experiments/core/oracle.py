"""The oracle rung: a head is trained one step ahead on true states and starts from one."""

from __future__ import annotations

import torch
from torch import Generator

from dynamics import Head, Rollout
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.members import Examples
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import (
    LONG_STEPS,
    score_drift,
    score_fixed_step,
    score_inversion,
    score_long_drift,
)
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene
from vidphys.seeding import derive
from vidphys.training.segments import from_trajectory

HORIZON = 20  # steps of a training trajectory, as in the study
OLDEST, AGES = 2000, 20  # reference steps before a training trajectory starts, and its grid


def true_segments(
    scene: Scene,
    trajectories: int,
    seed: int,
    k: int = 1,
    both_signs: bool = False,
    oldest: int = OLDEST,
    apart: int = 1,
    parts: int = 1,
) -> Examples:
    """Examples of ``k`` stored states from short reference trajectories.

    Args:
        scene, trajectories, seed, both_signs, oldest, apart: see :func:`true_trajectories`.
        k: stored states of an example.
        parts: steps in which a model goes from one stored state to the next.
    """
    trajectory = true_trajectories(scene, trajectories, seed, both_signs, oldest, apart)
    # Whole trajectories are held out, so that no held-out step has a neighbour in training.
    kept = HORIZON + 1 - k
    held_out = kept * max(1, trajectories // 16)
    return Examples(*from_trajectory(trajectory, k, parts).split(held_out))


def true_trajectories(
    scene: Scene,
    trajectories: int,
    seed: int,
    both_signs: bool = False,
    oldest: int = OLDEST,
    apart: int = 1,
) -> Rollout:
    """Reference trajectories of ``HORIZON`` stored states for training, ``apart`` steps apart.

    Only the forward law is sampled, G > 0, unless both signs are asked for. Each
    trajectory starts from a state that is up to ``oldest`` steps old, so that encounters and
    bodies that have flown apart are seen as often as rollouts meet them; with 0 from the
    generator's own.
    """
    rng = Generator().manual_seed(derive(seed, "train"))
    start, params = scene.sample(trajectories, rng)
    if not bool((params.coupling > 0).all()):
        raise ValueError("true_trajectories: training data must have G > 0")
    if both_signs:
        sign = 1 - 2 * (torch.arange(trajectories) % 2)
        params = params.with_coupling(sign * params.coupling)
    if not oldest:
        return scene.simulate(start, params, HORIZON * apart, apart)
    past = scene.simulate(start, params, oldest, oldest // AGES).states
    age = torch.randint(AGES + 1, (trajectories,), generator=rng)
    start = past[torch.arange(trajectories), age]
    return scene.simulate(start, params, HORIZON * apart, apart)


def held_out_question(scene: Scene, episodes: int, seed: int) -> Question:
    """Fresh episodes that no training saw; the head starts from the truth."""
    start, params = scene.sample(episodes, Generator().manual_seed(derive(seed, "test")))
    return Question(scene, start, start, params)


def score_oracle(recorder: Recorder, head: Head, question: Question) -> Rollout:
    """Both questions, the 10,000-step rollout, which is returned, and the Lyapunov time."""
    rolled = question.ask(head, LONG_STEPS)
    score_inversion(recorder, head, question, rolled)
    score_drift(recorder, head, question, rolled=rolled)
    score_retrace(recorder, head, question)
    score_fixed_step(recorder, head, question, rolled)
    score_long_drift(recorder, head, question, rolled)
    recorder.add_value("lyapunov_time", float(question.lyapunov_time.quantile(0.5)))
    return rolled
