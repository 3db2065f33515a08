"""Training on time derivatives: of true trajectories by stencils, of a head by its vector field.

A field's own slopes are one evaluation, where a step of an integrator is four or more, and no
integrator's error is learned with them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import torch
from torch import Tensor

from dynamics import Head, PhaseState, Rollout
from dynamics.generalised import Generalised
from vidphys.training.segments import Scale, Segments, from_trajectory

# Central differences of sixth order: at 0.01 s, good to 1e-7 for motions of up to 15 rad/s.
STENCIL = (-1 / 60, 3 / 20, -3 / 4, 0.0, 3 / 4, -3 / 20, 1 / 60)
REACH = len(STENCIL) // 2


def derivative_segments(trajectory: Rollout) -> Segments:
    """Every inner state of trajectories ``(b, t, n, d)`` with dt times its derivative.

    The derivatives stand where one-step increments do, so that both have one size.
    """
    states = trajectory.states.map(torch.Tensor.double)
    inner = replace(trajectory, states=states.map(lambda x: x[:, REACH : -REACH + 1]))
    segments = from_trajectory(inner, k=1)

    def slope(x: Tensor) -> Tensor:
        windows = x.unfold(1, len(STENCIL), 1)
        found = windows @ torch.tensor(STENCIL, dtype=x.dtype)
        return found.flatten(0, 1).unsqueeze(1).float()

    slopes = PhaseState(slope(states.q), slope(states.p))
    return replace(segments, q=slopes.q, p=slopes.p)


def match_slopes(head: Head, batch: Segments, scale: Scale) -> Tensor:
    """Mean squared error of the vector field, in units of the derivatives' spread."""
    assert batch.p is not None
    velocity, force = cast(Generalised, head).slopes(batch.start, batch.params)
    q = (velocity * batch.dt - batch.q.squeeze(-3)) / scale.q
    p = (force * batch.dt - batch.p.squeeze(-3)) / scale.p
    return q.square().mean() + p.square().mean()
