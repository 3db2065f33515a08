"""Potential energies V(q, c) and their forces.

A pair potential is V = G sum_{i<j} m_i m_j phi(q_i - q_j), or another law of the same kind. The
coupling multiplies the finished sum, so that a linear one makes the force exactly odd in G (the
study's Eq. 5 and Prop. 2), in every bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar, Protocol, cast, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.couplings import PairLaw
from dynamics.mlp import MLP
from dynamics.numbers import number
from dynamics.pairs import Block, Listed, pair_groups
from dynamics.state import Parameters


@runtime_checkable
class Potential(Protocol):
    """What a potential energy offers: V, and force = -dV/dq written out."""

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        """V, ``(..., n, d) -> (...)``."""

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        """-dV/dq, shape of ``q``."""


# (law, displacements) -> the gradient that torch's operations give, or None where it does not know
# such displacements.
Engine = Callable[["DisplacementPotential", Tensor], Tensor | None]
PIECE = 2**16  # pairs at once: a network of width 64 then needs tens of megabytes, not gigabytes


def _in_pieces(function: Callable[[Tensor], Tensor], displacement: Tensor, dim: int) -> Tensor:
    """``function(displacement)``, over some pairs at a time where no gradient is recorded.

    Args:
        function: of displacements ``(..., pairs, d)``, independent of each other.
        displacement: all of them.
        dim: axis of the pairs in the result.
    """
    pairs = displacement.shape[-2]
    if torch.is_grad_enabled() or displacement[..., 0].numel() <= PIECE:
        return function(displacement)
    size = max(1, PIECE * pairs // displacement[..., 0].numel())
    return torch.cat([function(x) for x in displacement.split(size, -2)], dim)


class PairPotential(nn.Module):
    """Sum over pairs of a function of the displacement; subclasses give the function.

    Newton's third law and the way that the coupling enters hold by construction.

    Args:
        law: what multiplies the function; gravity's G m_i m_j in open space by default.
    """

    def __init__(self, law: PairLaw | None = None) -> None:
        super().__init__()
        self.law = PairLaw() if law is None else law

    def pair_energy(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        """Pair function phi of a displacement, ``(..., d) -> (...)``; must be even."""
        raise NotImplementedError

    def pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        """Gradient of phi, ``(..., d) -> (..., d)``; odd, because phi is even."""
        raise NotImplementedError

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        strength, amount = self.law.strength(params)
        parts = []
        for pairs in self._groups(q):
            product, displacement = pairs.product(amount), self._displacement(pairs, q)
            parts.append((product * _in_pieces(self.pair_energy, displacement, -1)).sum(-1))
        return strength * (parts[0] if len(parts) == 1 else torch.stack(parts).sum(0))

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        strength, amount = self.law.strength(params)
        total = torch.zeros_like(q)
        for pairs in self._groups(q):
            product, displacement = pairs.product(amount), self._displacement(pairs, q)
            gradient = _in_pieces(self.pair_gradient, displacement, -2)
            total = pairs.added(total, product.unsqueeze(-1) * gradient)
        return strength[..., None, None] * total

    def _groups(self, q: Tensor) -> Iterator[Listed | Block]:
        return pair_groups(q.shape[-2], q.shape[:-2].numel(), q.device)

    def _displacement(self, pairs: Listed | Block, q: Tensor) -> Tensor:
        """q_i - q_j, ``(..., pairs, d)``."""
        return self.law.nearest(pairs.difference(q))


class SoftenedGravity(PairPotential):
    """phi = -1 / sqrt(r^2 + softening^2): the reference law of the study (its appendix A).

    Args:
        softening: the length epsilon in world units, > 0.
        law: see :class:`PairPotential`.

    Example:
        >>> law = Parameters(torch.ones(()), torch.ones(2))
        >>> q = torch.tensor([[0.0, 0.0], [1.0, 0.0]])
        >>> pull = SoftenedGravity(softening=0.1)
        >>> round(float(pull.energy(q, law)), 3)
        -0.995
        >>> [round(x, 3) for x in pull.force(q, law)[0].tolist()]  # on body 0
        [0.985, 0.0]
    """

    def __init__(self, softening: float = 0.1, law: PairLaw | None = None) -> None:
        super().__init__(law)
        if not softening > 0:
            raise ValueError(f"SoftenedGravity: softening must be > 0, got {softening}")
        self.softening = softening

    def pair_energy(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        return -(displacement.square().sum(-1) + self.softening**2).rsqrt()

    def pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        r2 = displacement.square().sum(-1, keepdim=True) + self.softening**2
        return displacement * r2.rsqrt() / r2


class DisplacementPotential(PairPotential):
    """phi(dq) learned from the displacement vector (4,417 parameters at width 64).

    The network sees the displacement squashed into a disk, u = dq / (REACH + r): the
    short distances, where a force varies most, get most of the disk, and the force vanishes at
    infinity by construction. It is averaged over u and -u: exchanging two bodies changes nothing.

    Attributes:
        gradient_engine: of the class: a faster way to the gradient of many pairs, see
            :mod:`dynamics.engines`.
    """

    gradient_engine: ClassVar[Engine | None] = None

    def __init__(self, space: int, width: int, activation: str, law: PairLaw | None = None) -> None:
        super().__init__(law)
        self.phi = MLP((space, width, width, 1), activation)

    def disk_energy(self, u: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        """Phi of a squashed displacement, ``(..., d) -> (...)``."""
        both = self.phi(SPREAD * torch.stack([u, -u])).squeeze(-1)
        return 0.5 * (both[0] + both[1])

    def disk_gradient(self, u: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        """Gradient of :meth:`disk_energy`, ``(..., d) -> (..., d)``."""
        both = self.phi.gradient(SPREAD * torch.stack([u, -u]))
        return 0.5 * SPREAD * (both[0] - both[1])

    def pair_energy(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        return self.disk_energy(displacement / (REACH + soft_length(displacement)))

    def pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        engine = type(self).gradient_engine
        found = engine(self, displacement) if engine else None
        return self.plain_pair_gradient(displacement) if found is None else found

    def plain_pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        """:meth:`pair_gradient` by torch's own operations, but for the network's."""
        r = soft_length(displacement)
        return unsquashed(self.disk_gradient(displacement / (REACH + r)), displacement, r)


class RadialPotential(PairPotential):
    """phi(r) learned from the distance alone: rotation is built in.

    The distance is squashed twice, at a short and at a long reach, for the same reason as in
    :class:`DisplacementPotential`.
    """

    NEAR, FAR = 0.2, 2.0  # world units

    def __init__(self, width: int, activation: str, law: PairLaw | None = None) -> None:
        super().__init__(law)
        self.phi = MLP((2, width, width, 1), activation)

    def _features(self, r: Tensor) -> Tensor:
        squashed = torch.cat([r / (self.NEAR + r), r / (self.FAR + r)], -1)
        return SPREAD * (2 * squashed - 1)

    def distance_energy(self, r: Float[Tensor, "*b 1"]) -> Float[Tensor, "*b"]:
        """Phi at a soft distance, ``(..., 1) -> (...)``."""
        return self.phi(self._features(r)).squeeze(-1)

    def slope(self, r: Float[Tensor, "*b 1"]) -> Float[Tensor, "*b 1"]:
        """dphi/dr at a soft distance, ``(..., 1)`` to ``(..., 1)``."""
        near, far = (2 * SPREAD * self.phi.gradient(self._features(r))).chunk(2, -1)
        return near * self.NEAR / (self.NEAR + r) ** 2 + far * self.FAR / (self.FAR + r) ** 2

    def pair_energy(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        return self.distance_energy(soft_length(displacement))

    def pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        r = soft_length(displacement)
        return self.slope(r) * displacement / r


SPREAD = 2.0  # the squashed inputs span (-2, 2), where tanh units resolve them well
REACH = 0.5  # world units: the distance that lands half-way out in the squashed disk
CORE = 0.05  # world units: rounds the tip of the distance at r = 0; not a softening of the law


def soft_length(displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b 1"]:
    """sqrt(r^2 + CORE^2), smooth where two bodies coincide, ``(..., d) -> (..., 1)``."""
    return (displacement.square().sum(-1, keepdim=True) + CORE**2).sqrt()


def unsquashed(
    slope: Float[Tensor, "*b d"], displacement: Float[Tensor, "*b d"], r: Float[Tensor, "*b 1"]
) -> Float[Tensor, "*b d"]:
    """A gradient with respect to u = dq / (REACH + r), turned into one with respect to dq.

    Args:
        slope: with respect to u, ``(..., d)``.
        displacement: dq, ``(..., d)``.
        r: its soft length, ``(..., 1)``.
    """
    along = (displacement * slope).sum(-1, keepdim=True) / (REACH + r)
    return slope / (REACH + r) - displacement * along / (r * (REACH + r))


class FreePotential(nn.Module):
    """V(q, c): one network of all positions and parameters, nothing imposed (HNN,
    Greydanus, Dzamba and Yosinski, NeurIPS 2019).
    """

    def __init__(self, coordinates: int, conditions: int, width: int, activation: str) -> None:
        super().__init__()
        self.network = MLP((coordinates + conditions, width, width, 1), activation)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return self.network(torch.cat([q.flatten(-2), params.flat], -1)).squeeze(-1)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        gradient = self.network.gradient(torch.cat([q.flatten(-2), params.flat], -1))
        return -gradient[..., : q.shape[-1] * q.shape[-2]].reshape(q.shape)


class HarmonicTrap(nn.Module):
    """V = stiffness sum_i |q_i - centre|^2 / 2: a confinement that no coupling changes.

    Args:
        stiffness: per second squared, of a unit mass.
        centre: ``(d,)``, world units; the origin where not given.
        learned: whether both are.
    """

    stiffness: float | Tensor
    centre: Tensor | None

    def __init__(
        self, stiffness: float, centre: Sequence[float] | None = None, learned: bool = False
    ) -> None:
        super().__init__()
        if learned:
            number(self, "stiffness", stiffness, True)
        else:
            self.stiffness = stiffness
        if centre is None:
            self.centre = None
        else:
            number(self, "centre", centre, learned)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return 0.5 * self.stiffness * self._away(q).square().sum((-2, -1))

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return -self.stiffness * self._away(q)

    def _away(self, q: Tensor) -> Tensor:
        return q if self.centre is None else q - self.centre.to(q)


class SumPotential(nn.Module):
    """Several potentials at once."""

    def __init__(self, parts: Sequence[Potential]) -> None:
        super().__init__()
        self.parts = nn.ModuleList(cast(Sequence[nn.Module], parts))
        self.conservative = all(getattr(part, "conservative", True) for part in parts)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return torch.stack([part.energy(q, params) for part in self._parts]).sum(0)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return torch.stack([part.force(q, params) for part in self._parts]).sum(0)

    @property
    def _parts(self) -> Sequence[Potential]:
        return cast(Sequence[Potential], list(self.parts))


class NoPotential(nn.Module):
    """V = 0: the zero-force (ballistic) predictor against which skill is measured."""

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return q.new_zeros(q.shape[:-2])

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return torch.zeros_like(q)
