"""What the study's baselines add to the one-step loss: an energy penalty, noise on the input."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from dynamics import Head, PhaseState
from dynamics.hybrid import shortcut_of
from vidphys.experiments.core.members import MemberLoss
from vidphys.scenes import Scene
from vidphys.training.segments import Scale, Segments, increment_error, predict

PENALTIES = ("squared", "absolute")  # the study states both; squared is its formula


def energy_penalised(scene: Scene, weight: float, form: str = "squared") -> MemberLoss:
    """The one-step loss plus ``weight`` times the change of the scene's *true* energy.

    Args:
        scene: whose exact energy is used; it is not learned.
        weight: lambda.
        form: ``squared`` or ``absolute`` difference of the energies.

    Raises:
        ValueError: another form.
    """
    if form not in PENALTIES:
        raise ValueError(f"energy_penalised: unknown form '{form}'; use one of {PENALTIES}")

    def loss(head: Head, batch: Segments, scale: Scale) -> Tensor:
        states = predict(head, batch)
        law = batch.params.map(lambda x: x.unsqueeze(1))
        before = scene.law.energy(batch.start, batch.params).unsqueeze(-1)
        change = scene.law.energy(states, law) - before
        penalty = change.square() if form == "squared" else change.abs()
        return increment_error(states, batch, scale) + weight * penalty.mean()

    return loss


def noisy(fraction: float) -> MemberLoss:
    """The one-step loss from a start with noise; the target stays the noise-free next state.

    Args:
        fraction: standard deviation of the noise, as a part of the batch's own in q and in p.
    """

    def loss(head: Head, batch: Segments, scale: Scale) -> Tensor:
        start = batch.start.map(lambda x: x + fraction * x.std() * torch.randn_like(x))
        shift = PhaseState(start.q - batch.start.q, start.p - batch.start.p)
        moved = replace(
            batch,
            start=start,
            q=batch.q - shift.q.unsqueeze(-3),
            p=None if batch.p is None else batch.p - shift.p.unsqueeze(-3),
        )
        return increment_error(predict(head, moved), moved, scale)

    return loss


def floored(share: float) -> MemberLoss:
    """The one-step loss, with momentum errors relative to no less than ``share`` of their spread.

    Where forces cancel, between charges of both signs or out of a contact's range, a body's own
    increment is a needless small measure: the rest of the batch would not be heard beside it.
    """

    def loss(head: Head, batch: Segments, scale: Scale) -> Tensor:
        least = replace(scale, p_small=max(scale.p_small, share * scale.p))
        return increment_error(predict(head, batch), batch, least)

    return loss


def shortcut_penalised(weight: float, share: float) -> MemberLoss:
    """:func:`floored` plus ``weight`` times the size of the shortcut's force.

    Args:
        weight: lambda, on the squared momentum that the shortcut adds in one step over the spread
            of what all forces add.
        share: see :func:`floored`.
    """
    fit = floored(share)

    def loss(head: Head, batch: Segments, scale: Scale) -> Tensor:
        free = shortcut_of(head).free_force(batch.start.q, batch.params)
        gained = free * batch.dt * batch.every / scale.p
        return fit(head, batch, scale) + weight * gained.square().mean()

    return loss
