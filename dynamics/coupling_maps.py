"""How a law's strength enters a potential of all coordinates: by rule, or by learned features.

A linear map says what happens at a strength of a sign never seen. Features that are localised on
positive strengths fit the same data and say nothing there (the study's factorial).
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.mlp import MLP
from dynamics.state import Parameters

CENTRES = 8
FIRST, LAST, WIDTH = 0.5, 1.5, 0.25  # units of G: the range that training data covers


def _linear(g: Tensor) -> Tensor:
    return g.unsqueeze(-1)


def _localised(g: Tensor) -> Tensor:
    centres = torch.linspace(FIRST, LAST, CENTRES, dtype=g.dtype, device=g.device)
    return torch.exp(-0.5 * ((g.unsqueeze(-1) - centres) / WIDTH).square())


class Gain(nn.Module):
    """A learned b(G): nothing but smoothness says what it is where no G was seen."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.network = MLP((1, width, 1))

    def forward(self, g: Tensor) -> Tensor:
        return self.network(g.unsqueeze(-1))


# name -> the features b(G), (...) -> (..., k), whose weighted sum multiplies what is learned
MAPS: dict[str, Callable[[Tensor], Tensor]] = {"linear": _linear, "localised": _localised}
GAIN = "gain"


def coupling_map(name: str) -> Callable[[Tensor], Tensor]:
    """A map by name.

    Raises:
        ValueError: there is none of this name.
    """
    if name not in MAPS:
        raise ValueError(f"coupling map: unknown '{name}'; known: {', '.join(MAPS)}")
    return MAPS[name]


class MappedPotential(nn.Module):
    """V = sum_k b_k(G) phi_k(q), phi one network of all positions with an output for each b_k.

    With the linear map and four coordinates: 4,545 parameters at width 64; the localised one has
    the most.

    Args:
        coordinates: entries of q.
        width, activation: of the network.
        map_name: of :data:`MAPS`, or ``gain`` for a learned function of G.
    """

    def __init__(self, coordinates: int, width: int, activation: str, map_name: str) -> None:
        super().__init__()
        self.map = Gain(width) if map_name == GAIN else coupling_map(map_name)
        outputs = self.map(torch.zeros(())).shape[-1]
        self.network = MLP((coordinates, width, width, outputs), activation)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return (self.map(params.coupling) * self.network(q.flatten(-2))).sum(-1)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        features = self.map(params.coupling).expand(*q.shape[:-2], -1)
        return -self.network.gradient(q.flatten(-2), features).reshape(q.shape)
