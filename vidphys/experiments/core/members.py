"""Training one head for every seed, side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from dynamics import Head
from vidphys.presets import OracleSizes
from vidphys.progress import Progress
from vidphys.runs.records import Recorder
from vidphys.seeding import derive
from vidphys.summary import FAILED, OK, Summary
from vidphys.training.ensemble import Ensemble, Stacked, stack
from vidphys.training.loop import (
    Batches,
    FitSettings,
    LearningRateChoice,
    choose_learning_rate,
    fit,
)
from vidphys.training.segments import Scale, Segments, scale_of, segment_loss

PROBE = 0.1  # share of the optimiser steps that each candidate learning rate is tried for

MemberLoss = Callable[[Head, Segments, Scale], Tensor]


class Examples(NamedTuple):
    """Training and held-out segments of one seed."""

    train: Segments
    held_out: Segments


def one_step(head: Head, batch: Segments, scale: Scale) -> Tensor:
    """The default loss: the increments of the stored steps, standardised."""
    return segment_loss(head, scale)(batch)


def train_members(
    name: str,
    make: Callable[[], Head],
    examples: Mapping[int, Examples],
    sizes: OracleSizes,
    recorders: Mapping[int, Recorder],
    loss: MemberLoss = one_step,
    device: str = "cpu",
    save_to: Path | None = None,
    progress: Progress | None = None,
) -> dict[int, Head]:
    """Train one head for each seed; all see the same budget and one learning rate.

    The rate is the one of the grid whose short trial has the smallest held-out error, summed over
    the seeds. A seed whose weights are not finite at the end is lost: its record says so and it
    is left out.

    Args:
        name: of the head, for seeds and checkpoints.
        make: builds an untrained head from torch's global generator.
        examples: by seed; equally many for each.
        sizes: steps, batch and grid.
        recorders: by seed; get ``learning_rate`` and the trials' errors, summed over seeds,
            ``held_out_one_step_error`` and ``training_failed``.
        loss: of one member, one batch and the sizes of the increments.
        device: where to compute; the heads stay there.
        save_to: JSON path of the checkpoint; ``None`` keeps none.
        progress: called as ``(step, steps, loss)``.
    """
    seeds = list(examples)
    # One scale for all seeds: it only sets units.
    scale = scale_of(examples[seeds[0]].train)
    heads = []
    for seed in seeds:
        torch.manual_seed(derive(seed, "init", name))
        head = make()
        every = examples[seed].train.every
        head.set_scale(scale.q / every, scale.p / every)
        head.see(examples[seed].train.start)
        heads.append(head)
    ensemble = Ensemble(heads).to(device)
    train = [examples[seed].train.to(device) for seed in seeds]
    held_out = stack([examples[seed].held_out.to(device) for seed in seeds])

    def member_loss(head: Head, batch: Segments) -> Tensor:
        return loss(head, batch, scale)

    order = derive(seeds[0], "order", name)
    choice = fit_ensemble(ensemble, member_loss, train, held_out, sizes, order, save_to, progress)
    with torch.no_grad():
        errors = ensemble.map(member_loss, held_out).tolist()
    trained = {}
    for seed, head, error in zip(seeds, ensemble.members(), errors, strict=True):
        lost = not is_finite(head)
        recorders[seed].add_value("learning_rate", choice.chosen)
        for rate, tried in choice.errors.items():
            failed = Summary(None, FAILED, 0, 0)
            summary = Summary(tried, OK, 0, 0) if math.isfinite(tried) else failed
            recorders[seed].add(f"trial_error_at_rate_{rate:g}", summary)
        recorders[seed].add_value("training_failed", float(lost))
        if not lost:
            recorders[seed].add_value("held_out_one_step_error", error)
            trained[seed] = head
    return trained


def fit_ensemble(
    ensemble: Ensemble[Head],
    loss: Callable[[Head, Any], Tensor],
    train: Sequence[Batches],
    held_out: Any,
    sizes: OracleSizes,
    order: int,
    save_to: Path | None = None,
    progress: Progress | None = None,
) -> LearningRateChoice:
    """Train models side by side, at the learning rate whose short trial errs least.

    Args:
        ensemble: is trained.
        loss: of one member and one batch of its.
        train: by member.
        held_out: stacked over members; a rate is chosen on it.
        sizes: steps, batch and grid.
        order: seed of the batches' order.
        save_to: JSON path of the checkpoint; ``None`` keeps none.
        progress: called as ``(step, steps, loss)``.
    """
    stacked = Stacked(train)
    probe = FitSettings(max(1, int(PROBE * sizes.steps)), sizes.batch, 0.0)
    rates = sizes.learning_rates
    choice = choose_learning_rate(
        ensemble, lambda tried: tried.loss(loss), stacked, held_out, rates, probe, order
    )
    settings = FitSettings(sizes.steps, sizes.batch, choice.chosen)
    fit(ensemble, ensemble.loss(loss), stacked, settings, order, save_to, progress)
    return choice


def is_finite(head: Head) -> bool:
    """Whether all of a head's weights are numbers."""
    return all(bool(torch.isfinite(p).all()) for p in head.parameters())
