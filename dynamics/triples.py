"""Interactions of three bodies that no sum over pairs is (the study's appendix G)."""

from __future__ import annotations

from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.mlp import MLP
from dynamics.potentials import SPREAD, soft_length
from dynamics.powers import COUPLINGS
from dynamics.state import Parameters

REACH = 0.7  # world units: the distance that lands half-way


@lru_cache(maxsize=64)
def triple_indices(bodies: int, device: torch.device) -> Tensor:
    """Indices of the triples i < j < k, ``(triples, 3)``; none for fewer than three bodies."""
    with torch.inference_mode(False):
        return torch.combinations(torch.arange(bodies, device=device), 3)


class TriplePotential(nn.Module):
    """V = c(G) sum_{i<j<k} m_i m_j m_k psi(r_ij, r_jk, r_ki); subclasses give psi.

    psi must not change when two of its distances are exchanged.

    Args:
        coupling: the function c, of :data:`dynamics.powers.COUPLINGS`.
    """

    def __init__(self, coupling: str = "linear") -> None:
        super().__init__()
        self.coupling = COUPLINGS[coupling]

    def triple_energy(self, sides: Float[Tensor, "*b 3 d"]) -> Float[Tensor, "*b"]:
        """The function psi of three displacements ``(..., 3, d)``, ``(...)``."""
        raise NotImplementedError

    def triple_gradient(self, sides: Float[Tensor, "*b 3 d"]) -> Float[Tensor, "*b 3 d"]:
        """Gradient of psi with respect to the displacements, ``(..., 3, d)``."""
        raise NotImplementedError

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        _, sides, product = self._triples(q, params)
        return self.coupling(params.coupling) * (product * self.triple_energy(sides)).sum(-1)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        triples, sides, product = self._triples(q, params)
        pull = product[..., None, None] * self.triple_gradient(sides)
        # Side a runs from body a to body a + 1 of the triple.
        on_bodies = pull - pull.roll(1, -2)
        total = torch.zeros_like(q).index_add(-2, triples.flatten(), on_bodies.flatten(-3, -2))
        return self.coupling(params.coupling)[..., None, None] * total

    @staticmethod
    def _triples(q: Tensor, params: Parameters) -> tuple[Tensor, Tensor, Tensor]:
        """Indices, sides ``(..., triples, 3, d)`` and products of masses ``(..., triples)``."""
        triples = triple_indices(q.shape[-2], q.device)
        shape = triples.shape
        corners = q.index_select(-2, triples.flatten()).unflatten(-2, shape)
        mass = params.mass.index_select(-1, triples.flatten()).unflatten(-1, shape)
        return triples, corners.roll(-1, -2) - corners, mass.prod(-1)


class PlummerTriple(TriplePotential):
    """psi = -1 / prod_sides sqrt(r^2 + softening^2): strong where all three are near each other.

    Args:
        softening: world units, > 0.
        strength: what multiplies psi.
    """

    def __init__(self, softening: float, strength: float = 1.0, coupling: str = "linear") -> None:
        super().__init__(coupling)
        if not softening > 0:
            raise ValueError(f"PlummerTriple: softening must be > 0, got {softening}")
        self.softening, self.strength = softening, strength

    def triple_energy(self, sides: Float[Tensor, "*b 3 d"]) -> Float[Tensor, "*b"]:
        squared = sides.square().sum(-1) + self.softening**2
        return -self.strength * squared.prod(-1).rsqrt()

    def triple_gradient(self, sides: Float[Tensor, "*b 3 d"]) -> Float[Tensor, "*b 3 d"]:
        squared = sides.square().sum(-1, keepdim=True) + self.softening**2
        return self.strength * squared.prod(-2, keepdim=True).rsqrt() * sides / squared


class LearnedTriple(TriplePotential):
    """psi learned from symmetric polynomials of the squashed sides: exchange is built in."""

    def __init__(self, width: int, activation: str, coupling: str = "linear") -> None:
        super().__init__(coupling)
        self.psi = MLP((3, width, width, 1), activation)

    def triple_energy(self, sides: Float[Tensor, "*b 3 d"]) -> Float[Tensor, "*b"]:
        return self.psi(self._features(_squashed(sides)).squeeze(-1)).squeeze(-1)

    def triple_gradient(self, sides: Float[Tensor, "*b 3 d"]) -> Float[Tensor, "*b 3 d"]:
        u = _squashed(sides)
        slope = self.psi.gradient(self._features(u).squeeze(-1)).unsqueeze(-1)
        first, second, third = slope.split(1, -2)
        other, further = u.roll(1, -2), u.roll(-1, -2)
        along = first + second * (other + further) + third * other * further
        r = soft_length(sides)
        return along * 2 * SPREAD * REACH / (REACH + r).square() * sides / r

    @staticmethod
    def _features(u: Tensor) -> Tensor:
        other = u.roll(1, -2)
        sums = u.sum(-2, keepdim=True), (u * other).sum(-2, keepdim=True)
        return torch.cat([*sums, u.prod(-2, keepdim=True)], -2)


def _squashed(sides: Tensor) -> Tensor:
    """Lengths in (-SPREAD, SPREAD), ``(..., 3, d) -> (..., 3, 1)``."""
    r = soft_length(sides)
    return SPREAD * (2 * r / (REACH + r) - 1)
