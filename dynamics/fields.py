"""Fields that pull a body by its mass: gravity near the ground, free or on a circle."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.numbers import number
from dynamics.state import Parameters


class UniformField(nn.Module):
    """V = -sum_i m_i g . q_i, which no coupling changes.

    Args:
        space: dimensions of space.
        acceleration: g, ``(d,)``, world units per second squared; zero where not given.
        learned: whether it is, from there on.

    Example:
        >>> field = UniformField(2, (0.0, -9.81))
        >>> law = Parameters(torch.ones(()), torch.tensor([2.0]))
        >>> [[round(x, 2) for x in f] for f in field.force(torch.zeros(1, 2), law).tolist()]
        [[0.0, -19.62]]
    """

    acceleration: Tensor

    def __init__(
        self, space: int, acceleration: Sequence[float] | None = None, learned: bool = True
    ) -> None:
        super().__init__()
        number(self, "acceleration", acceleration or [0.0] * space, learned)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return -(params.mass * (q @ self.acceleration.to(q.dtype))).sum(-1)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return params.mass.unsqueeze(-1) * self.acceleration.to(q.dtype).expand_as(q)


class Pendulum(nn.Module):
    """V = -m rate2 length^2 sum_i cos(q_i / length): weight on a circle of that radius.

    Args:
        rate2: square of the rate of small swings, per second squared; g / l of a point on a string.
        length: of the coordinates for an angle of one; 1 where they are angles.
        learned: whether ``rate2`` is.

    Example:
        >>> law = Parameters(torch.ones(()), torch.tensor([2.0]))
        >>> quarter = torch.full((1, 1), torch.pi / 2)
        >>> Pendulum(9.0).force(quarter, law).round(decimals=3).tolist()
        [[-18.0]]
    """

    rate2: Tensor

    def __init__(self, rate2: float, length: float = 1.0, learned: bool = True) -> None:
        super().__init__()
        self.length = length
        number(self, "rate2", rate2, learned)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        depth = (q / self.length).cos().sum(-1)
        return -self.rate2.to(q) * self.length**2 * (params.mass * depth).sum(-1)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        weight = params.mass.unsqueeze(-1) * self.rate2.to(q) * self.length
        return -weight * (q / self.length).sin()


class Well(nn.Module):
    """A force on each coordinate that is a cubic in it: a trap whose sides differ.

    F = push - stiffness q + second q^2 - third q^3, in world units and of a unit mass.

    Args:
        stiffness, push, second, third: the coefficients.
        learned: whether they are.
    """

    coefficients: Tensor

    def __init__(
        self, stiffness: float, push: float, second: float, third: float, learned: bool = True
    ) -> None:
        super().__init__()
        number(self, "coefficients", [push, -stiffness, second, -third], learned)

    @property
    def stiffness(self) -> Tensor:
        """At the origin, per second squared."""
        return -self.coefficients[1]

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        powers = torch.stack([q, q**2 / 2, q**3 / 3, q**4 / 4], -1)
        return -(powers @ self.coefficients.to(q)).sum((-2, -1))

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return torch.stack([torch.ones_like(q), q, q**2, q**3], -1) @ self.coefficients.to(q)


class EllipticTrap(nn.Module):
    """V = sum_i (q_i - centre) . K (q_i - centre) / 2: a confinement that differs by direction.

    Args:
        stiffness: K, symmetric, ``(d, d)``, per second squared, of a unit mass.
        centre: ``(d,)``, world units.
        learned: whether both are.

    Raises:
        ValueError: a stiffness that is not symmetric, whose force has no potential.

    Example:
        >>> trap = EllipticTrap(((4.0, 0.0), (0.0, 9.0)), (0.0, 0.0), learned=False)
        >>> law = Parameters(torch.ones(()), torch.ones(1))
        >>> trap.force(torch.tensor([[1.0, -1.0]]), law).tolist()
        [[-4.0, 9.0]]
    """

    rows: Tensor
    centre: Tensor

    def __init__(
        self,
        stiffness: Sequence[Sequence[float]],
        centre: Sequence[float],
        learned: bool = True,
    ) -> None:
        super().__init__()
        if any(stiffness[i][j] != stiffness[j][i] for i in range(len(centre)) for j in range(i)):
            raise ValueError(
                f"EllipticTrap: stiffness must be symmetric, got {tuple(map(tuple, stiffness))}"
            )
        number(self, "rows", stiffness, learned)
        number(self, "centre", centre, learned)

    @property
    def stiffness(self) -> Tensor:
        """K, ``(d, d)``; symmetric, whatever training makes of its rows."""
        return 0.5 * (self.rows + self.rows.mT)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        away = q - self.centre.to(q)
        return 0.5 * (away * (away @ self.stiffness.to(q))).sum((-2, -1))

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return -(q - self.centre.to(q)) @ self.stiffness.to(q)
