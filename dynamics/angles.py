"""Joint angles as a network should see them: harmonics of the torus, so that 2 pi is no step."""

from __future__ import annotations

from itertools import product

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from dynamics.mlp import MLP
from dynamics.state import Parameters


def frequencies(joints: int) -> Int[Tensor, "h n"]:
    """Integer vectors k in {-1, 0, 1}^n, one of each pair k and -k, without 0: ``(h, n)``."""
    vectors = [k for k in product((0, 1, -1), repeat=joints) if any(k)]
    return torch.tensor([k for k in vectors if next(x for x in k if x) > 0], device="cpu")


class Harmonics(nn.Module):
    """cos(k q) and sin(k q) for the lowest integer vectors k, of which smooth functions consist.

    Args:
        joints: number of angles n; there are (3^n - 1) features.
    """

    waves: Tensor

    def __init__(self, joints: int) -> None:
        super().__init__()
        self.register_buffer("waves", frequencies(joints).to(torch.get_default_dtype()))

    @property
    def size(self) -> int:
        """Number of features."""
        return 2 * self.waves.shape[0]

    def forward(self, q: Float[Tensor, "*b n"]) -> Float[Tensor, "*b h"]:
        """Angles ``(..., n)`` in radians to features ``(..., h)``."""
        phase = q @ self.waves.T
        return torch.cat([phase.cos(), phase.sin()], -1)

    def pullback(
        self, q: Float[Tensor, "*b n"], cotangent: Float[Tensor, "*b h"]
    ) -> Float[Tensor, "*b n"]:
        """Gradient with respect to the angles of features . cotangent, ``(..., n)``."""
        phase = q @ self.waves.T
        along_cos, along_sin = cotangent.chunk(2, -1)
        return (along_sin * phase.cos() - along_cos * phase.sin()) @ self.waves

    def pushforward(
        self, q: Float[Tensor, "*b n"], direction: Float[Tensor, "*b n"]
    ) -> Float[Tensor, "*b h"]:
        """Rate of the features while the angles move along ``direction``, ``(..., h)``."""
        phase, rate = q @ self.waves.T, direction @ self.waves.T
        return torch.cat([-phase.sin() * rate, phase.cos() * rate], -1)


class AnglePotential(nn.Module):
    """V(q, c) of joint angles: G U(q) (factored), or one network that is also given G.

    Args:
        joints: number of angles.
        conditions: entries of the parameters' vector; 0 for the factored form.
        width, activation: of the network.
    """

    scale: Tensor

    def __init__(self, joints: int, conditions: int, width: int, activation: str) -> None:
        super().__init__()
        self.harmonics = Harmonics(joints)
        self.conditions = conditions
        self.network = MLP((self.harmonics.size + conditions, width, width, 1), activation)
        self.register_buffer("scale", torch.ones(()))

    def set_scale(self, force: float) -> None:
        """Set the size of a typical force, so that the network's outputs are near 1."""
        self.scale = torch.full_like(self.scale, force)

    def _inputs(self, q: Tensor, params: Parameters) -> Tensor:
        features = self.harmonics(q.flatten(-2))
        return torch.cat([features, params.flat], -1) if self.conditions else features

    def _strength(self, params: Parameters) -> Tensor:
        return self.scale if self.conditions else self.scale * params.coupling

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return self._strength(params) * self.network(self._inputs(q, params)).squeeze(-1)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        slope = self.network.gradient(self._inputs(q, params))[..., : self.harmonics.size]
        gradient = self.harmonics.pullback(q.flatten(-2), slope).reshape(q.shape)
        return -self._strength(params)[..., None, None] * gradient
