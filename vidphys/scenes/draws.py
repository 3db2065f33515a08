"""Random starts that several scenes share."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dynamics import Parameters, PhaseState

Range = tuple[float, float]


def uniform(shape: tuple[int, ...], bounds: Range, rng: Generator) -> Tensor:
    """Float64 numbers between two bounds."""
    low, high = bounds
    return low + (high - low) * torch.rand(*shape, generator=rng, dtype=torch.float64)


def normal(shape: tuple[int, ...], std: float, rng: Generator) -> Tensor:
    """Float64 normal numbers of mean zero."""
    return std * torch.randn(*shape, generator=rng, dtype=torch.float64)


def at_rest(
    q: Float[Tensor, "*b n d"], velocity: Float[Tensor, "*b n d"], params: Parameters
) -> PhaseState:
    """A state without total momentum, so that the system stays where it is drawn."""
    p = params.mass.unsqueeze(-1) * velocity
    return PhaseState(q, p - p.mean(-2, keepdim=True))
