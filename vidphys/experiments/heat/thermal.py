"""The kinetic temperature of a stationary run, and how well it is known."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from dynamics import PhaseState
from vidphys.errors import InputError

RESAMPLES = 400


def kinetic_temperature(states: PhaseState, mass: Tensor) -> Tensor:
    """<p^2 / m> over bodies and axes, ``(b, t)``, k_B = 1.

    Args:
        states: ``(b, t, n, d)``.
        mass: ``(b, n)``.
    """
    return (states.p.double().square() / mass.double()[:, None, :, None]).mean((-2, -1))


@dataclass(frozen=True)
class Measured:
    """A temperature with its standard error.

    Args:
        value: mean over walkers and time; ``None`` where a walker was lost.
        error: block-bootstrap standard error.
        walkers: how many were followed.
        lost: how many were not finite.
    """

    value: float | None
    error: float
    walkers: int
    lost: int


def measure_temperature(series: Tensor, block: int, rng: Generator) -> Measured:
    """Mean of temperatures ``(walkers, t)`` and its block-bootstrap standard error.

    Neighbours in time are alike: whole blocks of ``block`` stored states are resampled, and a
    block several correlation times long is nearly independent of the next.

    Raises:
        InputError: fewer than two blocks.
    """
    lost = int((~torch.isfinite(series)).any(1).sum())
    if lost:
        return Measured(None, float("nan"), len(series), lost)
    whole = series.shape[1] // block * block
    if len(series) * (whole // block if block else 0) < 2:
        raise InputError(
            f"temperature: {tuple(series.shape)} values hold fewer than two blocks of {block}; "
            "follow more walkers, or for longer"
        )
    means = series[:, :whole].reshape(-1, block).mean(1)
    drawn = torch.randint(len(means), (RESAMPLES, len(means)), generator=rng)
    return Measured(float(means.mean()), float(means[drawn].mean(1).std()), len(series), 0)
