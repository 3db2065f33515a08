"""The oracle rung: a head is trained one step ahead on true states and starts from one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Generator

from dynamics import Head, Rollout, Terms
from vidphys.experiments.members import Examples, MemberLoss, one_step, train_members
from vidphys.experiments.scoring import (
    Question,
    score_drift,
    score_inversion,
    score_long_drift,
)
from vidphys.presets import OracleSizes
from vidphys.runs.records import Recorder
from vidphys.scenes import Scene
from vidphys.seeding import derive
from vidphys.training.loop import Progress
from vidphys.training.segments import Segments, from_trajectory

HORIZON = 20  # steps of a training trajectory (the study, C4)
OLDEST, AGES = 2000, 20  # reference steps before a training trajectory starts, and its grid


def true_segments(
    scene: Scene, trajectories: int, seed: int, k: int = 1, both_signs: bool = False
) -> tuple[Segments, Segments]:
    """Examples of ``k`` steps from short reference trajectories: (train, held out)."""
    trajectory = true_trajectories(scene, trajectories, seed, both_signs)
    # Whole trajectories are held out, so that no held-out step has a neighbour in training.
    kept = HORIZON + 1 - k
    return from_trajectory(trajectory, k).split(kept * max(1, trajectories // 16))


def true_trajectories(
    scene: Scene, trajectories: int, seed: int, both_signs: bool = False
) -> Rollout:
    """Reference trajectories of ``HORIZON`` steps for training.

    Only the forward law is sampled, G > 0 (C3), unless both signs are asked for (T11). Each
    trajectory starts from a state that is up to ``OLDEST`` steps old, so that encounters and
    bodies that have flown apart are seen as often as rollouts meet them.
    """
    rng = Generator().manual_seed(derive(seed, "train"))
    start, params = scene.sample(trajectories, rng)
    if not bool((params.coupling > 0).all()):
        raise ValueError("true_trajectories: training data must have G > 0")
    if both_signs:
        sign = 1 - 2 * (torch.arange(trajectories) % 2)
        params = params.with_coupling(sign * params.coupling)
    past = scene.simulate(start, params, OLDEST, OLDEST // AGES).states
    age = torch.randint(AGES + 1, (trajectories,), generator=rng)
    start = past[torch.arange(trajectories), age]
    return scene.simulate(start, params, HORIZON)


def train_on_states(
    name: str,
    terms: Terms,
    scene: Scene,
    sizes: OracleSizes,
    recorders: Mapping[int, Recorder],
    loss: MemberLoss = one_step,
    device: str = "cpu",
    save_to: Path | None = None,
    progress: Progress | None = None,
    k: int = 1,
    both_signs: bool = False,
) -> dict[int, Head]:
    """Build a head for each seed and train them on ``k``-step increments, side by side.

    See :func:`true_segments` for the data.

    Returns:
        The heads by seed, without those whose training was lost.
    """
    examples = {
        seed: Examples(*true_segments(scene, sizes.trajectories, seed, k, both_signs))
        for seed in recorders
    }
    return train_members(
        name,
        lambda: scene.build(terms),
        examples,
        sizes,
        recorders,
        loss,
        device,
        save_to,
        progress,
    )


def held_out_question(scene: Scene, episodes: int, seed: int) -> Question:
    """Fresh episodes that no training saw; the head starts from the truth."""
    start, params = scene.sample(episodes, Generator().manual_seed(derive(seed, "test")))
    return Question(scene, start, start, params)


def score_oracle(recorder: Recorder, head: Head, question: Question) -> None:
    """Both questions, the 10,000-step rollout, and the scene's Lyapunov time."""
    score_inversion(recorder, head, question)
    score_drift(recorder, head, question)
    score_long_drift(recorder, head, question)
    recorder.add_value("lyapunov_time", float(question.lyapunov_time.median()))
