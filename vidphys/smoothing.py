"""Observed tracks turned into states at the model's own step, with how far each can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.interpolate import make_interp_spline
from torch import Tensor

from dynamics import Parameters, PhaseState, Rollout
from dynamics.rollout import first_bad_step
from vidphys.perception.base import model_step

MIN_FRAMES = 6  # of a quintic spline
TOLERANCE = 0.1  # part of the typical acceleration that two splines may differ by


@dataclass(frozen=True)
class Smoothed:
    """Spline states of tracks, from the second frame to the last but one.

    Args:
        trajectory: states ``(b, s, n, d)``, one each model step.
        trust: ``(b, s)`` in (0, 1]: near 1 where a quintic and a cubic spline agree on the
            acceleration, small where frames are too coarse for an encounter.
        per_frame: model steps between frames.
    """

    trajectory: Rollout
    trust: Tensor
    per_frame: int


def smooth(positions: Tensor, params: Parameters, interval: float) -> Smoothed:
    """Interpolate positions ``(b, t, n, d)`` by quintic splines in time.

    Args:
        positions: world units, finite.
        params: give the masses.
        interval: seconds between frames.

    Raises:
        ValueError: fewer than six frames.
    """
    frames = positions.shape[1]
    if frames < MIN_FRAMES:
        raise ValueError(f"smooth: needs at least {MIN_FRAMES} frames to train on, got {frames}")
    dt, per_frame = model_step(interval)
    knots = np.arange(frames) * interval
    inner = interval + np.arange((frames - 3) * per_frame + 1) * dt
    path = make_interp_spline(knots, positions.double().numpy(), k=5, axis=1)
    rough = make_interp_spline(knots, positions.double().numpy(), k=3, axis=1)
    q, velocity = torch.from_numpy(path(inner)), torch.from_numpy(path(inner, 1))
    states = PhaseState(q, velocity * params.mass.double()[:, None, :, None])
    acceleration = torch.from_numpy(path(inner, 2))
    doubt = (acceleration - torch.from_numpy(rough(inner, 2))).norm(dim=-1).amax(-1)
    # Noise makes the splines differ everywhere; only what exceeds the usual is a sign of trouble.
    usual = torch.maximum(TOLERANCE * (1 + acceleration.norm(dim=-1).median()), 3 * doubt.median())
    trust = 1 / (1 + (doubt / usual).square())
    return Smoothed(Rollout(states, params, dt, first_bad_step(states)), trust, per_frame)
