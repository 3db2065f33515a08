"""Linear forces F = -K(G) q: symmetric stiffness is a potential, any other is only a field.

States are ``(..., n, 1)``: n coordinates of one dimension each (the study's factorial).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.coupling_maps import coupling_map
from dynamics.head import Head
from dynamics.integrators import Integrator, Memory, VectorField
from dynamics.state import Parameters, PhaseState


class Stiffness(nn.Module):
    """K(G) = confinement I + sum_k b_k(G) M_k.

    Args:
        content: the matrices M, ``(..., k, n, n)``; batch axes are those of the states.
        confinement: stiffness of each coordinate by itself, which no coupling changes.
        map_name: the features b, of :data:`dynamics.coupling_maps.MAPS`.

    Raises:
        ValueError: not as many matrices as the map has features.

    Example:
        >>> content = torch.tensor([[[0.0, 1.0], [1.0, 0.0]]])
        >>> Stiffness(content, confinement=2.0)(torch.tensor(0.5)).tolist()
        [[2.0, 0.5], [0.5, 2.0]]
    """

    content: Tensor

    def __init__(self, content: Tensor, confinement: float, map_name: str = "linear") -> None:
        super().__init__()
        self.map, self.confinement = coupling_map(map_name), confinement
        features = self.map(torch.zeros(())).shape[-1]
        if content.shape[-3] != features or content.shape[-1] != content.shape[-2]:
            raise ValueError(
                f"Stiffness: content must be (..., {features}, n, n) for the map '{map_name}', "
                f"got {tuple(content.shape)}"
            )
        self.register_buffer("content", content)

    def coupled(self, coupling: Float[Tensor, "*b"]) -> Float[Tensor, "*c n n"]:
        """The part that the coupling sets, ``(...) -> (..., n, n)``."""
        return torch.einsum("...k,...kij->...ij", self.map(coupling), self.content)

    def forward(self, coupling: Float[Tensor, "*b"]) -> Float[Tensor, "*c n n"]:
        """K at a coupling, ``(...) -> (..., n, n)``."""
        one = torch.eye(self.content.shape[-1], dtype=coupling.dtype, device=coupling.device)
        return self.coupled(coupling) + self.confinement * one


class QuadraticPotential(nn.Module):
    """V = q^T K(G) q / 2.

    Raises:
        ValueError: a stiffness that is not symmetric: its force has a curl and no potential.
    """

    def __init__(self, stiffness: Stiffness) -> None:
        super().__init__()
        if not torch.equal(stiffness.content, stiffness.content.mT):
            raise ValueError(
                "QuadraticPotential: the stiffness is not symmetric, so its force has no "
                "potential; take its symmetric part, or use LinearField"
            )
        self.stiffness = stiffness

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return -0.5 * (q * self.force(q, params)).sum((-2, -1))

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return -self.stiffness(params.coupling) @ q


class LinearField(Head):
    """dq/dt = p / m, dp/dt = -K(G) q with nothing asked of K: nothing is conserved."""

    def __init__(self, stiffness: Stiffness, integrator: Integrator) -> None:
        super().__init__()
        self.stiffness, self.integrator = stiffness, integrator

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        field = VectorField(
            velocity=lambda q, p: p / params.mass.unsqueeze(-1),
            force=lambda q, p: -self.stiffness(params.coupling) @ q,
        )
        return self.integrator.advance(field, state, dt, memory)

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return -self.stiffness(params.coupling) @ state.q
