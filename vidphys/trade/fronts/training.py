"""Training a head: trajectories and optimiser steps, against the error under a flipped law."""

from __future__ import annotations

from collections.abc import Iterator

from dynamics import Head
from vidphys import metrics
from vidphys.experiments.core.oracle import HORIZON, held_out_question, true_segments
from vidphys.experiments.core.question import Question
from vidphys.trade.context import Context, fit_head
from vidphys.trade.measure import Job, Scale

SCALE = Scale(
    "training",
    "training_seconds",
    1.0,
    "trained_nmse",
    "true trajectories at G = -1 over 150 steps, from true states",
)
FLIPPED = -1.0
FORCES_PER_STEP = 2  # of a one-step example: there is no last step's force to re-use


def jobs(context: Context) -> Iterator[Job]:
    """One head for each amount of data and of work, from the same initial weights."""
    scene, seed = context.scene, context.seed
    question = held_out_question(scene, context.sizes.clips, seed)
    for trajectories, steps in context.sizes.trainings:
        yield _job(context, question, trajectories, steps)


def _job(context: Context, question: Question, trajectories: int, steps: int) -> Job:
    examples, _ = true_segments(context.scene, trajectories, context.seed)
    batch = min(1024, len(examples))

    def errors(head: Head) -> dict[str, float]:
        return {"trained_nmse": flipped_nmse(head, question)}

    return Job(
        task=f"factored-radial on {context.scene.name}",
        configuration={"head": "factored-radial", "trajectories": trajectories, "steps": steps},
        work=lambda: fit_head(context.scene, examples, steps, context.seed),
        errors=errors,
        per_call=1,
        dtype="float32",
        units={
            "force_evaluations": float(FORCES_PER_STEP * steps * batch),
            "simulated_steps": float(HORIZON * trajectories),
        },
    )


def flipped_nmse(head: Head, question: Question) -> float:
    """Inversion error at G = -1; NaN where an episode was lost."""
    changed = question.params.with_coupling(FLIPPED)
    said = question.ask(head, question.steps, changed).states
    value = metrics.nmse(said, question.reference(changed).states).value
    return float("nan") if value is None else value
