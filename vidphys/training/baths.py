"""Friction and temperature of a heat bath, from tracks that also have an error of their own.

With the known forces taken out, increments of position are those of an Ornstein-Uhlenbeck process:
x_{k+1} - x_k remembers the one before by exp(-rate h), and nothing but kicks comes in between. How
far a body went before that knows neither those kicks nor the errors of the positions, so that it
gives the rate without a bias. The kicks' size is what remains summed over its lags: errors of
positions cancel there.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from binders import Tracks
from dynamics import Head, Parameters, PhaseState

APART = 2  # lags over which the errors of positions, and kicks, are shared
WAY = 3  # frames over which it is looked at how far a body went before
LEAST = 16  # increments


@dataclass(frozen=True)
class MeasuredBath:
    """What tracks tell of a bath; ``None`` where they do not.

    Args:
        rate: friction, per second.
        temperature: of the kicks, for k_B = 1.
    """

    rate: float | None
    temperature: float | None


def measure_bath(
    head: Head, tracks: Tracks, params: Parameters, interval: float, rate: float | None = None
) -> MeasuredBath:
    """Friction and temperature under the forces of a model.

    Args:
        head: whose force is that of the scene without the bath.
        tracks: positions in its units.
        params: of each clip, with a mass.
        interval: seconds between frames.
        rate: the friction, where tracks that tell none are to give a temperature all the same.

    Example:
        >>> from dynamics import ballistic
        >>> rng = torch.Generator().manual_seed(0)
        >>> v, h, path = torch.zeros(400, 1, 1).double(), 0.1, []
        >>> for _ in range(100):
        ...     v = 0.9 * v + torch.randn(v.shape, generator=rng, dtype=v.dtype)
        ...     path.append(v)
        >>> x = h * torch.stack(path, 1).cumsum(1)
        >>> tracks = Tracks(x, torch.ones(400, 100, 1), h * torch.arange(100))
        >>> law = Parameters(torch.ones(400), torch.ones(400, 1))
        >>> found = measure_bath(ballistic(), tracks, law, h)
        >>> round(found.rate, 1)  # -log(0.9) / h = 1.05
        1.0
    """
    x, mass = tracks.positions.double(), params.mass.double()
    seen = (tracks.confidence > 0).double()
    law = params.map(lambda y: y.double().unsqueeze(1))
    with torch.no_grad():
        force = copy.deepcopy(head).double().force(PhaseState(x, torch.zeros_like(x)), law)
    steps = x.diff(dim=1)
    whole = (seen[:, 1:] * seen[:, :-1]).unsqueeze(-1)
    pushed = interval**2 * (force / mass[:, None, :, None])[:, 1:-1]
    free = steps[:, 1:] - pushed
    both = whole[:, 1:] * whole[:, :-1]
    if int(both.sum()) < LEAST or x.shape[1] < LEAST:
        return MeasuredBath(None, None)
    first = WAY + 1  # the increment before which there is room for such a way
    old = x[:, WAY : -2 - 1][:, : free.shape[1] - first] - x[:, : free.shape[1] - first]
    use = both[:, first:] * (seen[:, WAY:-3] * seen[:, : -3 - WAY]).unsqueeze(-1)
    now = steps[:, first:-1]
    memory = float((use * free[:, first:] * old).sum() / (use * now * old).sum())
    found = -math.log(memory) / interval if 0 < memory < 1 else None
    rate = found or rate
    if rate is None:
        return MeasuredBath(None, None)
    decay = math.exp(-rate * interval)
    left = both * (free - decay * steps[:, :-1]) * mass[:, None, :, None].sqrt()
    spread = sum((1 + (lag > 0)) * _together(left, both, lag) for lag in range(APART + 1))
    temperature = rate * spread / (2 * interval * (1 - decay) ** 2)
    return MeasuredBath(found, temperature if temperature > 0 else None)


def _together(left: Tensor, seen: Tensor, lag: int) -> float:
    """Mean product of what is left and what was left so many frames before."""
    later, before = slice(lag, None), slice(0, left.shape[1] - lag)
    count = (seen[:, later] * seen[:, before]).sum() * left.shape[-1]
    return float((left[:, later] * left[:, before]).sum() / count)
