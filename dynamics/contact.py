"""Disks that touch: the soft contact, a learned potential of finite range, and impulses."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.activations import TANH
from dynamics.couplings import PairLaw
from dynamics.mlp import MLP
from dynamics.pairs import pair_indices
from dynamics.ports import Port
from dynamics.potentials import PairPotential
from dynamics.state import Parameters, PhaseState

TINY = 1e-9  # world units: keeps the direction of two coinciding bodies finite


def _distance(displacement: Tensor) -> Tensor:
    """``(..., d) -> (..., 1)``, with a slope also at zero."""
    return (displacement.square().sum(-1, keepdim=True) + TINY**2).sqrt()


class SoftContact(PairPotential):
    """phi = (diameter - r)^2 / 2 where two disks overlap, 0 elsewhere.

    Args:
        diameter: distance at which two disks touch, world units, > 0.
        law: see :class:`dynamics.potentials.PairPotential`.
    """

    def __init__(self, diameter: float, law: PairLaw | None = None) -> None:
        super().__init__(law)
        if not diameter > 0:
            raise ValueError(f"SoftContact: diameter must be > 0, got {diameter}")
        self.diameter = diameter

    def pair_energy(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        overlap = (self.diameter - _distance(displacement)).relu().squeeze(-1)
        return 0.5 * overlap.square()

    def pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        r = _distance(displacement)
        return -(self.diameter - r).relu() * displacement / r


class CutSpring(PairPotential):
    """phi = (min(r, cutoff)^2 - cutoff^2) / 2: a spring that breaks at the cutoff.

    Args:
        cutoff: distance from which on there is no force, world units, > 0.
        law: see :class:`dynamics.potentials.PairPotential`.
    """

    def __init__(self, cutoff: float, law: PairLaw | None = None) -> None:
        super().__init__(law)
        if not cutoff > 0:
            raise ValueError(f"CutSpring: cutoff must be > 0, got {cutoff}")
        self.cutoff = cutoff

    def pair_energy(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        return 0.5 * (displacement.square().sum(-1) - self.cutoff**2).clamp(max=0)

    def pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        within = displacement.square().sum(-1, keepdim=True) < self.cutoff**2
        return torch.where(within, displacement, torch.zeros_like(displacement))


class KnotPotential(PairPotential):
    """phi(r) = sum_k a_k max(b_k - r, 0)^2 / 2 with learned sizes a_k and reaches b_k.

    The force is piecewise linear in the distance and exactly zero beyond the longest reach: a
    contact's force has a kink and a finite range, which smooth networks only approach.

    Args:
        knots: number of terms.
        reach: world units; the first knots are spread evenly up to it.
        law: see :class:`dynamics.potentials.PairPotential`.
    """

    def __init__(self, knots: int, reach: float, law: PairLaw | None = None) -> None:
        super().__init__(law)
        self.reaches = nn.Parameter(reach * torch.arange(1, knots + 1) / knots)
        self.sizes = nn.Parameter(torch.randn(knots) / knots)

    def pair_energy(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        overlap = (self.reaches - _distance(displacement)).relu()
        return 0.5 * (overlap.square() * self.sizes).sum(-1)

    def pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        r = _distance(displacement)
        pull = ((self.reaches - r).relu() * self.sizes).sum(-1, keepdim=True)
        return -pull * displacement / r


class ImpulsePort(Port):
    """Impulses between pairs of bodies, along the line between them; momentum is conserved.

    Subclasses give the size of the impulse. It does not depend on the length of a step.

    Args:
        box: side of a periodic box in world units, or ``None``.
    """

    def __init__(self, box: float | None) -> None:
        super().__init__()
        self.law = PairLaw("alike", box=box)

    def impulse(
        self,
        r: Float[Tensor, "*b pairs 1"],
        approach: Float[Tensor, "*b pairs 1"],
        slide: Float[Tensor, "*b pairs 1"],
        mass: Float[Tensor, "*b pairs 1"],
    ) -> Float[Tensor, "*b pairs 1"]:
        """Size of each pair's impulse.

        Args:
            r: distances, ``(..., pairs, 1)``.
            approach: speeds at which the distances shrink, same shape.
            slide: speeds across the line between the bodies, same shape.
            mass: reduced masses, same shape.
        """
        raise NotImplementedError

    def kick(self, state: PhaseState, params: Parameters, dt: float) -> Float[Tensor, "*b n d"]:
        i, j = pair_indices(state.q.shape[-2], state.q.device)
        mass = params.mass.unsqueeze(-1)
        v = state.p / mass
        apart = self.law.nearest(state.q.index_select(-2, i) - state.q.index_select(-2, j))
        relative = v.index_select(-2, i) - v.index_select(-2, j)
        m_i, m_j = mass.index_select(-2, i), mass.index_select(-2, j)
        r = _distance(apart)
        normal = apart / r
        approach = -(relative * normal).sum(-1, keepdim=True)
        slide = _distance(relative + approach * normal)
        push = normal * self.impulse(r, approach, slide, m_i * m_j / (m_i + m_j))
        return state.p.index_add(-2, i, push).index_add(-2, j, push, alpha=-1)

    def drift(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return torch.zeros_like(state.p)  # between impulses


class Restitution(ImpulsePort):
    """Overlapping bodies that approach bounce with a learned restitution e.

    The impulse is (1 + e) times the reduced mass times the approach speed, faded in over the
    width ``EDGE`` so that the contact distance has a gradient.
    """

    EDGE = 0.01  # world units
    FIRST_DISTANCE = 0.5  # world units

    def __init__(self, box: float | None) -> None:
        super().__init__(box)
        self.distance = nn.Parameter(torch.tensor(self.FIRST_DISTANCE))
        self.raw = nn.Parameter(torch.zeros(()))

    @property
    def restitution(self) -> Tensor:
        """Parting speed over approach speed, between 0 and 1."""
        return torch.sigmoid(self.raw)

    def impulse(
        self,
        r: Float[Tensor, "*b pairs 1"],
        approach: Float[Tensor, "*b pairs 1"],
        slide: Float[Tensor, "*b pairs 1"],
        mass: Float[Tensor, "*b pairs 1"],
    ) -> Float[Tensor, "*b pairs 1"]:
        touching = torch.sigmoid((self.distance - r) / self.EDGE)
        return (1 + self.restitution) * mass * approach.relu() * touching


class FreeImpulse(ImpulsePort):
    """An impulse that is any function of distance and speeds."""

    def __init__(self, box: float | None, width: int = 64) -> None:
        super().__init__(box)
        self.network = MLP((3, width, width, 1), TANH)

    def impulse(
        self,
        r: Float[Tensor, "*b pairs 1"],
        approach: Float[Tensor, "*b pairs 1"],
        slide: Float[Tensor, "*b pairs 1"],
        mass: Float[Tensor, "*b pairs 1"],
    ) -> Float[Tensor, "*b pairs 1"]:
        return mass * self.network(torch.cat([r, approach, slide], -1))
