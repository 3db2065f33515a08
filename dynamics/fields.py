"""A uniform field, as gravity near the ground: the same acceleration for every body."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.state import Parameters


class UniformField(nn.Module):
    """V = -sum_i m_i g . q_i with a learned g, which no coupling changes.

    Args:
        space: dimensions of space; ``acceleration`` starts at zero.

    Example:
        >>> field = UniformField(space=2)
        >>> field.start_at([0.0, -9.81])
        >>> law = Parameters(torch.ones(()), torch.tensor([2.0]))
        >>> [[round(x, 2) for x in f] for f in field.force(torch.zeros(1, 2), law).tolist()]
        [[0.0, -19.62]]
    """

    def __init__(self, space: int) -> None:
        super().__init__()
        self.acceleration = nn.Parameter(torch.zeros(space))

    def start_at(self, acceleration: list[float]) -> None:
        """Begin training at this acceleration, ``(d,)``."""
        with torch.no_grad():
            self.acceleration.copy_(torch.tensor(acceleration))

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return -(params.mass * (q @ self.acceleration.to(q.dtype))).sum(-1)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return params.mass.unsqueeze(-1) * self.acceleration.to(q.dtype).expand_as(q)
