"""``vidphys view --seeds``: the seeds of one cell side by side, from one start."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vidphys.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from dynamics import Head
    from vidphys.experiments.core.question import Question

EPISODES = 8  # that are rolled; fewer do not roll in fused loops. The first is shown


def write_seeds(run: Path, cell: str, path: Path) -> None:
    """Write the recording of an episode that no training saw, as each seed's model rolls it.

    All begin at the true start of the first seed's first episode.

    Args:
        run: folder of a ladder.
        cell: of it.
        path: the ``.rrd``.

    Raises:
        InputError: the run kept no model of this cell.
    """
    from vidphys.experiments.core.oracle import held_out_question
    from vidphys.experiments.ladder import CELLS
    from vidphys.opened import open_run
    from viz.seeds import write_seeds_recording

    opened, heads = open_run(run), {}
    for seed in opened.settings.get("seeds", []):
        if any(part.startswith(f"{cell.replace('/', '-')}-s{seed}/") for part in opened.parts):
            heads[seed] = opened.head(cell, seed).requires_grad_(False)
    if not heads:
        raise InputError(f"view: --seeds: {run} kept no model of {cell}")
    scene = CELLS[cell].scene()  # type: ignore[attr-defined]
    asked = held_out_question(scene, EPISODES, next(iter(heads)))
    seeds = {seed: _rolled(asked, head) for seed, head in heads.items()}
    about = {
        "cell": cell,
        "seeds": ", ".join(map(str, seeds)),
        "coupling": str(float(asked.params.coupling[0])),
        "start": "the same for all, and true: what a rung sees is not asked here",
    }
    write_seeds_recording(seeds, about, path)


def _rolled(asked: Question, head: Head) -> dict[str, np.ndarray]:
    """The first episode under both laws, in truth and by a head."""
    import numpy as np

    from vidphys.experiments.core.showcase import FLIPPED, SHOWN_STEPS

    every = max(asked.every, round(asked.step_of(head) / asked.scene.dt))
    question = replace(asked, every=every)
    flipped = question.params.with_coupling(FLIPPED)
    ways = {
        "truth": question.reference(question.params, SHOWN_STEPS),
        "prediction": question.ask(head, SHOWN_STEPS),
        "counterfactual_truth": question.reference(flipped, SHOWN_STEPS),
        "counterfactual": question.ask(head, SHOWN_STEPS, flipped),
    }
    count = min(way.states.q.shape[1] for way in ways.values())
    arrays = {role: way.states.q[0, :count].double().numpy() for role, way in ways.items()}
    times = ways["truth"].times[:count].double().numpy()
    return {**arrays, "times": times, "half_extent": np.asarray(4.0)}
