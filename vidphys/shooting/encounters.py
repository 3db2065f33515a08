"""Where fits begin for clips in which two bodies pass each other faster than frames show.

A difference of frames says nothing then of how they go round each other, and no fit that begins
with it finds that. So the momentum that they have relative to each other is sought on a grid: of
all that the head rolls through a short window, the one that comes nearest to what was seen.
"""

from __future__ import annotations

from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor

from dynamics import Head, Parameters, PhaseState
from readouts.differencing import backward_difference
from vidphys.placement import suited
from vidphys.shooting.aim import PRECISE
from vidphys.shooting.step import model_step, roll

PLANE = 2  # dimensions
DIRECTIONS, SIZES = 48, 40  # of the momenta that are tried


def sought(
    head: Head,
    positions: Float[Tensor, "b t n d"],
    params: Parameters,
    interval: float,
    largest: float,
) -> PhaseState:
    """States of all frames, of the grid's best start for the two bodies that are closest.

    All else goes by differences of frames.

    Args:
        head: the law.
        positions: of a few frames in the plane, at least three; two bodies or more.
        params: of each clip, ``(b,)`` and ``(b, n)``.
        interval: seconds between frames.
        largest: relative momentum that is tried.
    """
    found = [
        _best(head, path, params[row : row + 1], interval, largest)
        for row, path in enumerate(positions)
    ]
    return PhaseState(*(torch.stack([getattr(x, part) for x in found]) for part in ("q", "p")))


def _best(head: Head, path: Tensor, law: Parameters, interval: float, largest: float) -> PhaseState:
    """The same of one clip, ``(t, n, d)``."""
    mass = law.mass[0].to(path)
    momenta = -backward_difference(path.flip(0)[None], mass[None], interval).p[0]
    one, two = _closest(path)
    together = (momenta[one] + momenta[two]) / (mass[one] + mass[two])
    grid = _grid(largest).to(path)
    starts = momenta.expand(len(grid), *momenta.shape).clone()
    starts[:, one], starts[:, two] = mass[one] * together + grid, mass[two] * together - grid
    begin = PhaseState(path[0].expand(starts.shape).clone(), starts)
    many = law.map(lambda x: x.expand(len(grid), *x.shape[1:]))
    dt, every = model_step(interval)
    with torch.no_grad():
        given = suited((begin, many), head)
        rolled = roll(head, *given, len(path) - 1, dt, every).map(lambda x: x.to(path))
    error = (rolled.q - path[1:]).square().sum(-1) / PRECISE**2
    best = int(error.nan_to_num(nan=torch.inf).log1p().mean((1, 2)).argmin())
    return PhaseState(
        torch.cat([begin.q[best, None], rolled.q[best]]),
        torch.cat([begin.p[best, None], rolled.p[best]]),
    )


def _closest(path: Tensor) -> tuple[int, int]:
    """The two bodies that are nearest to each other over all frames ``(t, n, d)``."""
    pairs = list(combinations(range(path.shape[1]), 2))
    apart = [float((path[:, i] - path[:, j]).norm(dim=-1).mean()) for i, j in pairs]
    return pairs[apart.index(min(apart))]


def _grid(largest: float) -> Tensor:
    """Momenta in all directions of the plane, ``(g, 2)``."""
    sizes = largest * torch.arange(1, SIZES + 1) / SIZES
    angles = 2 * torch.pi * torch.arange(DIRECTIONS) / DIRECTIONS
    ways = torch.stack([angles.cos(), angles.sin()], -1)
    return (sizes[:, None, None] * ways).flatten(0, 1)
