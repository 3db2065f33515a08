"""Kinetic energies T(p): how momentum becomes velocity."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.mlp import MLP
from dynamics.state import Parameters, kinetic_energy


@runtime_checkable
class Kinetic(Protocol):
    """What a kinetic energy offers: T, and velocity = dT/dp written out."""

    def energy(self, p: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        """T, ``(..., n, d) -> (...)``."""

    def velocity(self, p: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        """dT/dp, shape of ``p``."""


class FixedKinetic(nn.Module):
    """T = sum |p|^2 / 2m, the canonical kinetic energy; nothing is learned.

    Example:
        >>> law = Parameters(torch.ones(()), torch.tensor([2.0]))
        >>> p = torch.tensor([[2.0, 0.0]])
        >>> float(FixedKinetic().energy(p, law)), FixedKinetic().velocity(p, law).tolist()
        (1.0, [[1.0, 0.0]])
    """

    def energy(self, p: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return kinetic_energy(p, params.mass)

    def velocity(self, p: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return p / params.mass.unsqueeze(-1)


class BodyKinetic(nn.Module):
    """T = sum_i tau(p_i, m_i): one learned function shared by the bodies."""

    def __init__(self, space: int, width: int, activation: str) -> None:
        super().__init__()
        self.tau = MLP((space + 1, width, width, 1), activation)

    def energy(self, p: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return self.tau(_with_mass(p, params)).squeeze(-1).sum(-1)

    def velocity(self, p: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return self.tau.gradient(_with_mass(p, params))[..., :-1]


class FreeKinetic(nn.Module):
    """T(p, c): one network of all momenta and parameters (HNN, as :class:`FreePotential`)."""

    def __init__(self, coordinates: int, conditions: int, width: int, activation: str) -> None:
        super().__init__()
        self.network = MLP((coordinates + conditions, width, width, 1), activation)

    def energy(self, p: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return self.network(torch.cat([p.flatten(-2), params.flat], -1)).squeeze(-1)

    def velocity(self, p: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        gradient = self.network.gradient(torch.cat([p.flatten(-2), params.flat], -1))
        return gradient[..., : p.shape[-1] * p.shape[-2]].reshape(p.shape)


def _with_mass(p: Tensor, params: Parameters) -> Tensor:
    mass = params.mass.unsqueeze(-1).expand(*p.shape[:-1], 1)
    return torch.cat([p, mass], -1)
