"""Symplectic consistency: what a discovered momentum is without it, and with it."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from dynamics import PhaseState
from vidphys import metrics
from vidphys.data.clips import Clips
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_drift, score_inversion, score_lost
from vidphys.experiments.pixels.seen import Seen, draw, pixel_scene, score_state
from vidphys.perception.base import FitTask
from vidphys.perception.catalogue import RUNGS
from vidphys.perception.cnn import CHUNK
from vidphys.perception.discovered import SEEN
from vidphys.perception.free_momentum import FreeMomentum, fit_free_momentum
from vidphys.placement import CPU, device_of, moved
from vidphys.runs.records import Recorder
from vidphys.seeding import derive
from vidphys.symplecticity import symplecticity

WEIGHTS = {"free": 0.0, "consistent": 1.0}
HEADS = ("factored", "factored-learned-kinetic")
DISCOVERED = RUNGS["cnn-discovered"]


def latent_cell(weight: float, heads: Sequence[str]) -> Cell:
    """A cell that trains a latent through each head, which is a part, and asks that head."""

    def run(task: CellTask) -> None:
        scene = pixel_scene()
        for seed in task.seeds:
            seen = draw(scene, DISCOVERED, task.pixel, seed)
            for head in heads:
                recorder = task.recorder(seed, scene, head, head, "free-momentum", "cnn")
                fit_seed = derive(seed, "perception", "free-momentum")
                folder = None if task.folder is None else task.folder / f"s{seed}-{head}"
                how = folder, task.progress, task.device
                fit = FitTask(seen.train, task.pixel, fit_seed, head, *how)
                try:
                    trained = fit_free_momentum(fit, weight)
                except FloatingPointError:
                    score_lost(recorder, task.pixel.held_out)
                else:
                    score_latent(recorder, trained, seen)

    return run


def score_latent(recorder: Recorder, trained: FreeMomentum, seen: Seen) -> None:
    """Both residuals of the latent, and the study's questions to its own head from there.

    The latent is that of the last frame but one, between its neighbours; the map whose residuals
    are told is fitted on the training clips.
    """
    latent, truth = latent_states(trained, seen.test), middle(seen.test)
    taught, known = latent_states(trained, seen.train), middle(seen.train)
    question = Question(pixel_scene(), latent, truth, seen.test.params)
    score_state(recorder, question)
    design = torch.cat([taught.flat, latent.flat])
    for name, true, given in (("q_residual", truth.q, known.q), ("p_residual", truth.p, known.p)):
        state = torch.cat([given, true]).flatten(1)
        recorder.add(name, metrics.affine_residual(design, state, len(taught.q)))
    found = symplecticity(taught.flat, known, latent.flat, truth)
    recorder.add_value("symplectic_r2", found.r2)
    recorder.add_value("symplectic_deviation", found.deviation)
    score_inversion(recorder, trained.head, question)
    score_drift(recorder, trained.head, question)
    score_retrace(recorder, trained.head, question)


def middle(clips: Clips) -> PhaseState:
    """True states in the middle of the last three frames, ``(b, n, 2)``."""
    return clips.states[:, -1 - SEEN // 2]


def latent_states(trained: FreeMomentum, clips: Clips) -> PhaseState:
    """Latents of the clips' last three frames, ``(b, n, 2)``."""
    found: list[tuple[Tensor, Tensor]] = []
    with torch.no_grad():
        for some in torch.arange(len(clips)).split(CHUNK):
            frames = clips.images(some, device_of(trained))[:, -SEEN:]
            state = moved(trained.states(trained.perception.locate(frames)), CPU)
            found.append((state.q, state.p))
    q, p = (torch.cat(x) for x in zip(*found, strict=True))
    return PhaseState(q, p)


CONSISTENCY = Table.told(
    "symplectic-consistency",
    cells={name: latent_cell(weight, HEADS) for name, weight in WEIGHTS.items()},
    settings={"scene": pixel_scene().settings, "weights": WEIGHTS},
)
