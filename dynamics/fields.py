"""Fields of one body: gravity near the ground, free or on a circle, wells, and fixed places."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.numbers import number
from dynamics.state import Parameters

NEAR_ONE = 1e-6  # of a power, up to which its potential is a logarithm


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


class Tether(nn.Module):
    """V = stiffness sum_i (|q_i - centre| - rest)^2 / 2: a spring from a fixed place.

    Args:
        stiffness: per second squared, of a unit mass.
        rest: the distance at which it does not pull, world units.
        centre: the place, ``(d,)``, world units.
        learned: whether they are.

    Example:
        >>> spring = Tether(4.0, 1.0, (0.0, 0.0), learned=False)
        >>> law = Parameters(torch.ones(()), torch.ones(1))
        >>> spring.force(torch.tensor([[1.5, 0.0]]), law).tolist()
        [[-2.0, -0.0]]
    """

    stiffness: Tensor
    rest: Tensor
    centre: Tensor

    def __init__(
        self, stiffness: float, rest: float, centre: Sequence[float], learned: bool = True
    ) -> None:
        super().__init__()
        number(self, "stiffness", stiffness, learned)
        number(self, "rest", rest, learned)
        number(self, "centre", centre, learned)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        _, far = _away(q, self.centre)
        return 0.5 * self.stiffness.to(q) * (far - self.rest.to(q)).square().sum((-2, -1))

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        away, far = _away(q, self.centre)
        return -self.stiffness.to(q) * (far - self.rest.to(q)) * (away / far)


class Centre(nn.Module):
    """A fixed place that pushes, F = strength (r / near)^-power at the distance r from it.

    Args:
        strength: at the distance ``near``, world units per second squared, of a unit mass; below
            zero where it pulls.
        power: of the distance, by which it grows less.
        centre: the place, ``(d,)``, world units.
        near: world units.
        learned: whether strength, power and place are.

    Example:
        >>> sun = Centre(-4.0, 2.0, (0.0, 0.0), learned=False)
        >>> law = Parameters(torch.ones(()), torch.ones(1))
        >>> sun.force(torch.tensor([[2.0, 0.0]]), law).tolist()
        [[-1.0, -0.0]]
    """

    strength: Tensor
    power: Tensor
    centre: Tensor

    def __init__(
        self,
        strength: float,
        power: float,
        centre: Sequence[float],
        near: float = 1.0,
        learned: bool = True,
    ) -> None:
        super().__init__()
        if not near > 0:
            raise ValueError(f"Centre: near must be > 0, got {near}")
        self.near = near
        number(self, "strength", strength, learned)
        number(self, "power", power, learned)
        number(self, "centre", centre, learned)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        log = (_away(q, self.centre)[1] / self.near).log()
        less = 1 - self.power.to(q)
        # (x^less - 1) / less, which goes to log x as less goes to zero
        close = less.abs() < NEAR_ONE
        grown = torch.where(close, log, torch.expm1(less * log) / torch.where(close, 1, less))
        return -self.strength.to(q) * self.near * grown.sum((-2, -1))

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        away, far = _away(q, self.centre)
        return self.strength.to(q) * (far / self.near) ** -self.power.to(q) * away / far


def _away(q: Tensor, centre: Tensor) -> tuple[Tensor, Tensor]:
    """From a place to bodies ``(..., n, d)``, and the distance ``(..., n, 1)``, never zero."""
    away = q - centre.to(q)
    return away, away.norm(dim=-1, keepdim=True).clamp_min(torch.finfo(q.dtype).tiny)
