"""Forces between pairs whose dependence on the distance is known, but for a number or two."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dynamics.couplings import PairLaw
from dynamics.numbers import number
from dynamics.potentials import PairPotential

CORE = 0.01  # world units, below which a force without a bound grows no further


@dataclass(frozen=True)
class Shape:
    """A function phi of the distance r and a length s.

    Args:
        energy: phi, of r squared and s.
        pull: its slope over r, of the same; what a displacement is multiplied by.
        sized: whether there is an s.
        sharp: whether ``pull`` has no bound as r goes to zero.
    """

    energy: Callable[[Tensor, Tensor], Tensor]
    pull: Callable[[Tensor, Tensor], Tensor]
    sized: bool = True
    sharp: bool = False


def _inside(r2: Tensor, s: Tensor) -> Tensor:
    return (1 - r2 / s**2).clamp_min(0)


def _overlap(r2: Tensor, s: Tensor) -> Tensor:
    return (s - r2.sqrt()).clamp_min(0)


SHAPES: dict[str, Shape] = {
    "inverse-square": Shape(
        lambda r2, s: -((r2 + s**2) ** -0.5), lambda r2, s: (r2 + s**2) ** -1.5
    ),
    "inverse": Shape(lambda r2, s: 0.5 * (r2 + s**2).log(), lambda r2, s: 1 / (r2 + s**2)),
    "inverse-cube": Shape(lambda r2, s: -0.5 / (r2 + s**2), lambda r2, s: (r2 + s**2) ** -2.0),
    "gaussian": Shape(
        lambda r2, s: -(s**2) * (-0.5 * r2 / s**2).exp(), lambda r2, s: (-0.5 * r2 / s**2).exp()
    ),
    "cut-off": Shape(
        lambda r2, s: -(s**2) / 6 * _inside(r2, s) ** 3, lambda r2, s: _inside(r2, s) ** 2
    ),
    "contact": Shape(
        lambda r2, s: 0.5 * _overlap(r2, s) ** 2,
        lambda r2, s: -_overlap(r2, s) * r2.rsqrt(),
        sharp=True,
    ),
    "spring": Shape(lambda r2, s: 0.5 * r2, lambda r2, s: torch.ones_like(r2), sized=False),
    "point": Shape(lambda r2, s: -r2.rsqrt(), lambda r2, s: r2**-1.5, sized=False, sharp=True),
    "rest-length": Shape(
        lambda r2, s: r2.sqrt(), lambda r2, s: r2.rsqrt(), sized=False, sharp=True
    ),
    "twelve": Shape(
        lambda r2, s: r2**-6.0 / 12, lambda r2, s: -(r2**-7.0), sized=False, sharp=True
    ),
    "six": Shape(lambda r2, s: -(r2**-3.0) / 6, lambda r2, s: r2**-4.0, sized=False, sharp=True),
}
"""By name: ``twelve`` and ``six`` are the two of Lennard-Jones (1924), ``rest-length`` is what a
spring has beside ``spring`` where it rests at a length, ``point`` is gravity without softening."""


class ShapedPotential(PairPotential):
    """A pair potential of a known shape: strength times phi(r), and a length where phi has one.

    Args:
        shape: of :data:`SHAPES`.
        strength: of the force, which pulls where it is above zero (a contact pushes); world units
            to the power in :data:`dynamics.terms.potentials.SHAPE_LENGTHS`, per second squared, of
            unit sources.
        length: world units, > 0.
        learned: whether strength and length are.
        law: see :class:`dynamics.potentials.PairPotential`.

    Raises:
        ValueError: an unknown shape, or no length.

    Example:
        >>> from dynamics import Parameters
        >>> spring = ShapedPotential("spring", 3.0, learned=False)
        >>> law = Parameters(torch.ones(()), torch.ones(2))
        >>> spring.force(torch.tensor([[0.0], [2.0]]), law).flatten().tolist()
        [6.0, -6.0]
    """

    strength: Tensor
    length: Tensor

    def __init__(
        self,
        shape: str,
        strength: float,
        length: float = 1.0,
        learned: bool = True,
        law: PairLaw | None = None,
    ) -> None:
        super().__init__(law)
        if shape not in SHAPES:
            raise ValueError(
                f"ShapedPotential: unknown shape '{shape}'; known: {', '.join(SHAPES)}"
            )
        if not length > 0:
            raise ValueError(f"ShapedPotential: length must be > 0, got {length}")
        self.shape = shape
        number(self, "strength", strength, learned)
        number(self, "length", length, learned and self._phi.sized)

    def pair_energy(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b"]:
        r2 = displacement.square().sum(-1)
        length, out = self.length.to(r2), self._outside(r2)
        # a parabola within the core, of the slope at its edge
        core = 0.5 * self._phi.pull(out, length) * (r2 - out)
        return self.strength.to(r2) * (self._phi.energy(out, length) + core)

    def pair_gradient(self, displacement: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
        out = self._outside(displacement.square().sum(-1, keepdim=True))
        return self.strength.to(out) * self._phi.pull(out, self.length.to(out)) * displacement

    @property
    def _phi(self) -> Shape:
        """By name, because functions without one cannot be sent to another process."""
        return SHAPES[self.shape]

    def _outside(self, r2: Tensor) -> Tensor:
        """R squared, not below the core's where there is one."""
        return r2.clamp_min(CORE**2) if self._phi.sharp else r2
